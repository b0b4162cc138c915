"""What begins the night: a line for cron, or a service and a timer for systemd."""

import getpass
import os
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path

from pipeline.errors import ConfigurationError
from pipeline.nightly.minutes import INDEX_FILE
from pipeline.nightly.settings import NightlySettings

LOG_FILE = "nightly.log"
"""Where cron's line puts the log, in the output folder."""

_UNIT = "dynahull-nightly"

_SERVICE = """[Unit]
Description=Clean the maps that are new or changed
Documentation=https://arxiv.org/abs/2401.07541

[Service]
Type=oneshot
User={user}
ExecStart={command}
# Only the night itself is told to stop; it stops its run, whose work is kept.
KillMode=mixed
TimeoutStopSec=2min
SuccessExitStatus=130
# A map that takes all memory shall not end the night.
OOMPolicy=continue
Nice=10
"""

_TIMER = """[Unit]
Description=Every night: clean the maps that are new or changed

[Timer]
OnCalendar=*-*-* {at}:00
Persistent=true

[Install]
WantedBy=timers.target
"""


def user_name() -> str:
    """Return the name of the user, or the number of one without a name."""
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return str(os.getuid())


def nightly_call(source: Path, given: Sequence[str] = ()) -> list[str]:
    """Return the words that start the night of a YAML file, with settings, from anywhere."""
    # The name a virtual environment gives it, not what that is a link to.
    script = Path(sys.executable).with_name("dynahull-pipeline")
    program = [str(script)] if script.is_file() else [sys.executable, "-P", "-m", "pipeline"]
    settings = [word for each in given for word in ("--set", each)]
    return [*program, "nightly", str(source.absolute()), *settings]


def crontab_line(settings: NightlySettings, source: Path, given: Sequence[str] = ()) -> str:
    """Return the line of a crontab.

    The log goes into a file; only of a night that did not go well does cron have something to mail.
    """
    hour, minute = (int(part) for part in settings.at.split(":"))
    output = shlex.quote(str(settings.output))
    log = shlex.quote(str(settings.output / LOG_FILE))
    index = shlex.quote(f"see {settings.output / INDEX_FILE}")
    call = shlex.join(nightly_call(source, given))
    command = (
        f"mkdir -p {output} && {{ {call} >> {log} 2>&1 || "
        f'echo "dynahull-pipeline nightly: exit code $?," {index}; }}'
    ).replace("%", "\\%")  # to cron, % is the end of the command
    return f"{minute} {hour} * * * {command}"


def systemd_service(source: Path, given: Sequence[str] = ()) -> str:
    """Return the service unit."""
    program, *arguments = nightly_call(source, given)
    # In arguments, and only there, $ begins the name of a variable.
    words = [program, *(word.replace("$", "$$") for word in arguments)]
    command = " ".join(map(_systemd_word, words))
    return _SERVICE.format(user=user_name(), command=command)


def install_text(settings: NightlySettings, source: Path, given: Sequence[str] = ()) -> str:
    """Return all that `--schedule` prints of a YAML file; nothing is installed by it."""
    for word in (str(source.absolute()), str(settings.output), sys.executable, *given):
        if not word.isprintable():
            raise ConfigurationError(f"{word!r}: expected printable characters in one line")
    return "\n".join(
        [
            "# For cron: this line, by `crontab -e`.",
            crontab_line(settings, source, given),
            "",
            "# Or for systemd, /etc/systemd/system/:",
            f"# ---- {_UNIT}.service",
            systemd_service(source, given),
            f"# ---- {_UNIT}.timer",
            _TIMER.format(at=settings.at.zfill(5)),
            f"# and then: systemctl daemon-reload && systemctl enable --now {_UNIT}.timer",
        ]
    )


def _systemd_word(word: str) -> str:
    """Quote a word as systemd.service(5) reads it: backslash and " escaped, % doubled."""
    word = word.replace("\\", "\\\\").replace('"', '\\"').replace("%", "%%")
    return f'"{word}"'
