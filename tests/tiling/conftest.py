"""Help that the tests of all formats share."""

import random
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tiling.errors import MapFormatError
from tiling.formats import MapReader, open_map

LONGEST_SECONDS = 2.0


@pytest.fixture(scope="session")
def rewrite() -> Callable[[MapReader, Path, np.ndarray, int], Path]:
    """A function that writes the chosen points of a map to a new file, and returns its path."""

    def write(reader: MapReader, path: Path, chosen: np.ndarray, max_points: int) -> Path:
        with reader.writer(path, int(chosen.sum())) as writer:
            for batch in reader.batches(max_points):
                assert 0 < len(batch.xyz) <= max_points
                rows = slice(batch.first_row, batch.first_row + len(batch.xyz))
                writer.write(batch.select(chosen[rows]))
        return path

    return write


@pytest.fixture(scope="session")
def read_xyz() -> Callable[..., np.ndarray]:
    """A function that reads all coordinates of a map, checking the row numbers on the way."""

    def read(reader: MapReader, max_points: int = 1000) -> np.ndarray:
        parts = [np.empty((0, 3))]
        for batch in reader.batches(max_points):
            assert batch.first_row == sum(len(part) for part in parts)
            assert batch.xyz.dtype == np.float64
            parts.append(batch.xyz)
        xyz = np.concatenate(parts)
        assert len(xyz) == reader.description.point_count
        return xyz

    return read


@pytest.fixture(scope="session")
def survives(read_xyz) -> Callable[[bytes, Path, int], tuple[int, int]]:
    """A function that damages a file in many ways, and checks that each is read or refused.

    It returns how many were read and how many refused.
    """

    def check(content: bytes, path: Path, times: int) -> tuple[int, int]:
        chance = random.Random(len(content))
        read = refused = 0
        for _ in range(times):
            path.write_bytes(damaged(content, chance))
            start = time.monotonic()
            try:
                reader = open_map(path)
                xyz = read_xyz(reader, max_points=7)
                with reader.writer(path.with_name(f"copy{path.suffix}"), len(xyz)) as writer:
                    for batch in reader.batches(100):
                        writer.write(batch.records)
                read += 1
            except MapFormatError as error:
                assert str(error).startswith(f"{path}: expected ")
                assert "\n" not in str(error)
                refused += 1
            assert time.monotonic() - start < LONGEST_SECONDS
        return read, refused

    return check


def damaged(content: bytes, chance: random.Random) -> bytes:
    """Return the content cut off, or with some bytes changed, put in or taken out."""
    if chance.random() < 0.15:
        return content[: chance.randrange(len(content))]
    edited = bytearray(content)
    # Half of the edits go to the header, where they do most.
    end = len(edited) if chance.random() < 0.5 else min(len(edited), 300)
    for _ in range(chance.randint(1, 4)):
        at = chance.randrange(min(end, len(edited)))
        kind = chance.random()
        if kind < 0.5:
            edited[at] = chance.choice([0, 9, 10, 32, 45, 48, 57, 127, 255, chance.randrange(256)])
        elif kind < 0.7:
            edited[at:at] = chance.choice([b"9", b"99999999", b" ", b"\n", b"\0\0\0\0", b"-"])
        elif kind < 0.9:
            del edited[at : at + chance.randint(1, 8)]
        else:
            edited[at] ^= 1 << chance.randrange(8)
    return bytes(edited)
