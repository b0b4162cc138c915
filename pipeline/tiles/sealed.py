"""Small JSON files of a work folder, each with a checksum that tells whether it is damaged."""

import json
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pipeline.errors import WorkError
from tiling.atomic import atomic_file

GO_ON = "the same command makes it again, and goes on"
"""What to do about work that is damaged."""

_HEAD = b'{"checksum": "%08x", "content": '
_HEAD_SIZE = len(_HEAD % 0)
_TAIL = b"}"


def write_sealed(path: Path, values: Mapping[str, Any]) -> None:
    """Write values to a file that appears whole or not at all."""
    content = json.dumps(values).encode()
    with atomic_file(path) as temporary:
        temporary.write_bytes(_HEAD % zlib.crc32(content) + content + _TAIL)


def read_sealed(path: Path) -> dict[str, Any]:
    """Read what `write_sealed` wrote.

    Raises
    ------
    WorkError
        When the file is not there, or not as it was written.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise WorkError(f"{path}: expected a file of a run's work, found {reason}") from error
    content = data[_HEAD_SIZE : -len(_TAIL)]
    if data != _HEAD % zlib.crc32(content) + content + _TAIL:
        raise WorkError(f"{path}: expected a file of a run's work, found a damaged one; {GO_ON}")
    values: dict[str, Any] = json.loads(content)
    return values


def read_if_whole(path: Path) -> dict[str, Any] | None:
    """Read what `write_sealed` wrote; None where it is not there, or not as it was written."""
    try:
        return read_sealed(path)
    except WorkError:
        return None
