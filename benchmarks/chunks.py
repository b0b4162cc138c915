"""Measure survey, pieces, chunks and the reading of chunks of a map: time a point and memory.

    python -m benchmarks.chunks MAP [--max-points 1000000] [--halo 2] [--format parquet]

Times include the reading of the map, which is given too. The memory is the peak of the process.
"""

import argparse
import resource
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from tiling.chunks import ChunkStore, grid_of, read_chunk, write_chunk
from tiling.collection import MapCollection, find_map_files
from tiling.layout import quadtree
from tiling.pieces import gathered, sort_by_tile
from tiling.survey import survey

Answer = TypeVar("Answer")

ROWS_IN_A_PIECE = 2_500_000


def main() -> None:
    """Measure one map."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("map", nargs="+")
    parser.add_argument("--max-points", type=int, default=1_000_000)
    parser.add_argument("--halo", type=float, default=2.0)
    parser.add_argument("--format", choices=["parquet", "las", "laz"], default="parquet")
    arguments = parser.parse_args()
    collection = MapCollection(find_map_files(arguments.map))
    count = collection.point_count

    def timed(name: str, work: Callable[[], Answer]) -> Answer:
        start = time.perf_counter()
        result = work()
        microseconds = (time.perf_counter() - start) / count * 1e6
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(f"{name:12} {microseconds:6.3f} us a point, peak {peak:4.0f} MB")
        return result

    survey(collection, range(min(count, 10)))  # compiles
    found = timed("survey", lambda: survey(collection))
    layout = timed("quadtree", lambda: quadtree(found.occupancy, arguments.max_points))
    grid = None if arguments.format == "parquet" else grid_of(collection, found)
    with tempfile.TemporaryDirectory() as folder:
        store = ChunkStore(Path(folder), layout, arguments.halo, count, arguments.format, grid)
        store.save()
        ranges = collection.row_ranges(ROWS_IN_A_PIECE)
        tiles = range(len(layout))
        sort_by_tile(store, collection, range(min(count, 10)))
        pieces = timed("pieces", lambda: [sort_by_tile(store, collection, r) for r in ranges])

        def assemble(tile: int) -> int:
            runs = [
                points[first : first + size]
                for points, of_piece in pieces
                for of_tile, first, size in of_piece.tolist()
                if of_tile == tile
            ]
            chunk = gathered(store, tile, runs)
            write_chunk(store, tile, chunk)
            return len(chunk)

        stored = timed("assemble", lambda: sum(map(assemble, tiles)))
        timed("read chunks", lambda: sum(len(read_chunk(store, tile)) for tile in tiles))
        size = sum(store.chunk_path(tile).stat().st_size for tile in tiles)
    timed("read map", lambda: sum(1 for _ in collection.batches()))
    print(f"{len(layout)} tiles, {stored / count:.2f} points stored for each of the map's,")
    print(f"{size / max(stored, 1):.1f} bytes a stored point")


if __name__ == "__main__":
    main()
