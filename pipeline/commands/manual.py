"""The manual page, from what the commands say of themselves."""

import re
from importlib.metadata import version
from typing import Any


def manual_page(context: Any) -> str:
    """Return the page of all commands, as roff for `man`.

    Parameters
    ----------
    context : typer.Context
        Of the group of commands.
    """
    group, name = context.command, "dynahull-pipeline"
    lines = [
        f'.TH {name.upper()} 1 "" "{name} {version(name)}" "User commands"',
        ".SH NAME",
        _text(f"{name} - {group.help}"),
        ".SH SYNOPSIS",
        _text(f"{name} COMMAND [OPTIONS] ..."),
        ".SH COMMANDS",
    ]
    for title in group.list_commands(context):
        command = group.get_command(context, title)
        if command.hidden:
            continue
        own = type(context)(command, info_name=title, parent=context)
        lines += [f'.SS "{_text(" ".join([title, *command.collect_usage_pieces(own)]))}"']
        lines += [_text(command.help or "")]
        for parameter in command.params:
            record = parameter.get_help_record(own)
            if record is not None:
                lines += [".TP", f".B {_text(record[0])}", _text(record[1])]
    return "\n".join([*lines, ".SH EXIT STATUS", _text(group.epilog or "")])


def _text(text: str) -> str:
    """Return text for roff: one line, without what roff takes for its own."""
    text = re.sub(r"\[/?\w*\]", "", " ".join(text.split()))  # rich's marks
    return text.replace("\\", "\\e").replace("-", "\\-")
