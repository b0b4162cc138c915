"""What `--schedule` prints: systemd takes it, a shell reads it back, and cron runs it."""

import json
import os
import shlex
import shutil
import subprocess
import sys
import time

import pytest

from pipeline.nightly.install import crontab_line, install_text, systemd_service
from pipeline.nightly.settings import load_nightly_settings

COMMAND = [sys.executable, "-c", "from pipeline.commands.app import main; main()", "nightly"]
AWKWARD = 'it\'s 100% of "my" $HOME maps'


@pytest.fixture
def awkward(tmp_path):
    """A file of settings in a folder whose name needs quoting everywhere."""
    folder = tmp_path / AWKWARD
    (folder / "incoming").mkdir(parents=True)
    source = folder / "nightly.yaml"
    source.write_text(
        "inputs: [{maps: incoming, settings: [neighbours.k=8, clustering.count=2, "
        "ground.method=none, output.report=none]}]\noutput: cleaned\nsettle: 1 s\nwait: null\n"
    )
    return source


def test_the_line_of_cron_is_read_back_by_a_shell(awkward):
    settings = load_nightly_settings(awkward, ["at='7:05'"])
    line = crontab_line(settings, awkward)
    assert line.startswith("5 7 * * * ")
    command = line.removeprefix("5 7 * * * ")
    assert command.replace("\\%", "").count("%") == 0, "to cron, % is the end of the command"
    words = shlex.split(command.replace("\\%", "%"))
    assert str(awkward) in words
    assert str(awkward.parent / "cleaned" / "nightly.log") in words


@pytest.mark.linux_only
@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd is not there")
def test_systemd_takes_service_and_timer(awkward, tmp_path):
    text = install_text(load_nightly_settings(awkward, ["at=22:30"]), awkward)
    units = []
    for suffix in ("service", "timer"):
        units.append(tmp_path / f"dynahull-nightly.{suffix}")
        # Up to the next heading or the end, comments within a unit included.
        part = text.split(f"# ---- dynahull-nightly.{suffix}\n")[1]
        units[-1].write_text(part.split("# ----")[0].split("# and then")[0])
    assert "OnCalendar=*-*-* 22:30:00" in units[1].read_text()
    done = subprocess.run(
        ["systemd-analyze", "verify", *units], capture_output=True, text=True, check=False
    )
    ours = [line for line in done.stderr.splitlines() if "dynahull-nightly" in line]
    assert (done.returncode, ours) == (0, [])


def test_what_systemd_is_not_to_expand_is_escaped(awkward):
    (line,) = (each for each in systemd_service(awkward).splitlines() if "ExecStart" in each)
    assert line.endswith('it\'s 100%% of \\"my\\" $$HOME maps/nightly.yaml"')


def test_the_command_prints_both_and_installs_nothing(awkward):
    done = subprocess.run(
        [*COMMAND, str(awkward), "--schedule"], capture_output=True, text=True, check=True
    )
    assert crontab_line(load_nightly_settings(awkward), awkward) in done.stdout.splitlines()
    assert "[Service]" in done.stdout
    assert "[Timer]" in done.stdout
    assert sorted(os.listdir(awkward.parent)) == ["incoming", "nightly.yaml"]  # noqa: PTH208


def test_what_was_set_beside_the_file_holds_for_the_nights_as_well(awkward):
    given = "inputs=[{maps: '50% of $HOME/*.npy'}]"
    done = subprocess.run(
        [*COMMAND, str(awkward), "--set", given, "--set", "output=there", "--schedule"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    line = next(line for line in done.stdout.splitlines() if line.startswith("0 2 * * * "))
    words = shlex.split(line.replace("\\%", "%"))
    at = words.index(str(awkward)) + 1
    assert words[at : at + 4] == ["--set", given, "--set", "output=there"]
    assert str(awkward.parent / "there" / "nightly.log") in words
    service = next(line for line in done.stdout.splitlines() if line.startswith("ExecStart="))
    escaped = given.replace("%", "%%").replace("$", "$$")
    assert service.endswith(f'"--set" "{escaped}" "--set" "output=there"')


@pytest.fixture
def cron():
    """A cron daemon, and the crontab of this user, which is put back as it was."""
    if shutil.which("cron") is None or shutil.which("crontab") is None:
        pytest.skip("Debian's cron is not installed")
    if os.geteuid() != 0:
        pytest.skip("only root may start a cron daemon")
    listed = subprocess.run(["crontab", "-l"], capture_output=True, text=True, check=False)
    earlier = listed.stdout if listed.returncode == 0 else None

    def install(line):
        text = (earlier or "") + line + "\n"
        subprocess.run(["crontab", "-"], input=text, text=True, check=True)

    # Where one runs already, this one leaves at once, and that one does it.
    daemon = subprocess.Popen(["cron", "-f"], stderr=subprocess.DEVNULL)
    try:
        yield install
    finally:
        daemon.terminate()
        daemon.wait()
        if earlier is None:
            subprocess.run(["crontab", "-r"], check=True)
        else:
            subprocess.run(["crontab", "-"], input=earlier, text=True, check=True)


@pytest.mark.linux_only
def test_cron_begins_the_night(awkward, cron, map_bytes):
    (awkward.parent / "incoming" / "a.npy").write_bytes(map_bytes(1, 90))
    summary = awkward.parent / "cleaned" / "nightly.json"
    until, begins = time.monotonic() + 300, 0.0
    while not summary.exists() or not json.loads(summary.read_text())["finished"]:
        assert time.monotonic() < until, "cron did not begin the night"
        if time.time() > begins + 60 and not summary.exists():
            # The next full minute that is far enough away; on a busy machine it may be missed.
            begins = (time.time() + 10) // 60 * 60 + 60
            at = time.strftime("%H:%M", time.localtime(begins))
            cron(crontab_line(load_nightly_settings(awkward, [f"at='{at}'"]), awkward))
        time.sleep(0.5)
    found = json.loads(summary.read_text())
    assert (found["exit_code"], found["counts"]) == (0, {"cleaned": 1})
    log = (awkward.parent / "cleaned" / "nightly.log").read_text()
    assert "1 cleaned" in log
    assert "\x1b" not in log
