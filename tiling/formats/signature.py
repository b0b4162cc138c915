"""What a file seems to be, told from its first bytes, for messages about the wrong kind of file."""

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
