"""Parquet files of any name, maps or not."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq


@contextmanager
def open_parquet(path: Path, **options: Any) -> Iterator[pq.ParquetFile]:
    """Open a Parquet file of any name: Arrow itself takes names that are UTF-8, and no others.

    Parameters
    ----------
    path : Path
    options
        Of `pyarrow.parquet.ParquetFile`.
    """
    with pa.OSFile(os.fsencode(path), "rb") as source, pq.ParquetFile(source, **options) as file:
        yield file


def row_count(path: Path) -> int:
    """Return the number of rows of a file."""
    with open_parquet(path) as file:
        return int(file.metadata.num_rows)
