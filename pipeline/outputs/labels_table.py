"""`labels.parquet`: what became of every point, for whoever wants to look into it."""

from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from dynahull.labels import Label
from pipeline.tiles.writing import BATCH
from tiling.output_file import create_file


def write_labels(
    labels: NDArray[np.uint8],
    cluster: NDArray[np.int32],
    density: NDArray[np.float64],
    score: NDArray[np.float32],
    path: Path,
) -> None:
    """Write label, cluster, density and score of every point, in input order, as Parquet.

    Parameters
    ----------
    labels : (N,) uint8 array
    cluster : (N,) int32 array
    density : (N,) float64 array
    score : (N,) float32 array
    path : Path
    """
    titles = pa.array([label.title for label in Label])
    schema = pa.schema(
        {
            "label": pa.dictionary(pa.int8(), pa.string()),
            "cluster": pa.int32(),
            "density": pa.float64(),
            "score": pa.float32(),
        }
    )
    with ExitStack() as stack:
        file = stack.enter_context(create_file(path))
        writer = stack.enter_context(pq.ParquetWriter(file, schema, compression="zstd"))
        for start in range(0, len(labels), BATCH):
            rows = slice(start, start + BATCH)
            codes = pa.array(np.asarray(labels[rows]).astype(np.int8))
            columns = [
                pa.DictionaryArray.from_arrays(codes, titles),
                pa.array(np.asarray(cluster[rows])),
                pa.array(np.asarray(density[rows])),
                pa.array(np.asarray(score[rows])),
            ]
            writer.write_table(pa.table(columns, schema=schema), row_group_size=BATCH)
