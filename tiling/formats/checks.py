"""What any file is checked for: how it begins, and what lies behind the last point counted.

A count that is too low, or zero, leaves points behind that nobody would miss. So bytes there are
refused as soon as one more point has room in them; less than that, and padding, is left out and
noted.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from tiling.errors import MapFormatError

_SIGNATURES = (
    (b"version https://git-lfs", "a git-LFS pointer, not the file it stands for"),
    (b"LASF", "a LAS or LAZ file"),
    (b"PAR1", "a Parquet file"),
    (b"PARE", "an encrypted Parquet file"),
    (b"\x93NUMPY", "a NumPy .npy file"),
    (b"PK\x03\x04", "a ZIP archive"),
    (b"PK\x05\x06", "an empty ZIP archive"),
    (b"# .PCD", "a PCD file"),
    (b"VERSION .7", "a PCD file"),
    (b"VERSION 0.7", "a PCD file"),
    (b"ply\n", "a PLY file"),
    (b"ply\r", "a PLY file"),
    (b"\x1f\x8b", "a gzip file"),
    (b"<!DOCTYPE", "an HTML page"),
    (b"<html", "an HTML page"),
)

SIGNATURE_LENGTH = 32
"""Bytes from the start of a file that `kind_of` looks at."""


def kind_of(start: bytes) -> str:
    """Say what a file is by its first `SIGNATURE_LENGTH` bytes, such as `"an empty file"`.

    Where no known kind begins so, the bytes themselves are said.
    """
    if not start:
        return "an empty file"
    for signature, kind in _SIGNATURES:
        if start.startswith(signature):
            return kind
    if not start.strip(b"\0"):
        return "zero bytes"
    return f"a file that begins with {start[:16]!r}"


def check_signature(path: Path, signature: bytes, expected: str) -> None:
    """Refuse a file that does not begin as its kind does."""
    with path.open("rb") as file:
        start = file.read(SIGNATURE_LENGTH)
    if not start.startswith(signature):
        raise MapFormatError(path, expected, kind_of(start), at="byte 0")


PADDING = b"\0\t\n\r "
"""Bytes that writers fill a file up with, to the end of a page or of a line."""

_BLOCK = 1 << 20


def check_leftover(
    file: BinaryIO, start: int, stop: int, record_size: int, path: Path, counted: str
) -> tuple[str, ...]:
    """Refuse bytes that could be points; return a note on those that cannot, if there are any.

    Parameters
    ----------
    start, stop : int
        The bytes that nothing in the header speaks for.
    record_size : int
        Bytes of a point, or of the smallest.
    path, counted : Path, str
        The file, and what its header counts, such as `"1000 points"`: for messages.

    Raises
    ------
    MapFormatError
        When there is room for a point, and something other than padding in it.
    """
    size = stop - start
    if size <= 0:
        return ()
    room = size // max(record_size, 1)
    if room and any(block.strip(PADDING) for block in read_blocks(file, start, stop)):
        more = f"{size} bytes behind them, room for {room} more of {record_size} bytes"
        raise MapFormatError(path, f"no points but the {counted} counted", more, f"byte {start}")
    return (f"The {size} bytes after the last point are left out.",)


def read_blocks(file: BinaryIO, start: int, stop: int) -> Iterator[bytes]:
    """Yield the bytes of a file from one to before another, as far as they are there."""
    file.seek(start)
    left = stop - start
    while left and (block := file.read(min(_BLOCK, left))):
        yield block
        left -= len(block)
