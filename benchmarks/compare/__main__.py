"""The same data for all methods, and the tables of the paper, as Markdown.

    python -m benchmarks.compare                                       # one simulated scene
    python -m benchmarks.compare --scenes simulated-indoor simulated-street --seeds 0 1 2
    python -m benchmarks.compare --scenes street-64 room --seconds 900
    python -m benchmarks.compare --methods DynaHull DUFOMap --set scans=100
    python -m benchmarks.compare --json figures.json --resume      # goes on where it was cut off

Every method runs in a process of its own, on as many cores as `--cores` says. What needs scans and
poses must first find a thing that crosses an empty hall in full view (the scene `crossing`), what
has the map only must find single points above a dense floor. What does not is skipped, as is what
is not installed, and the tables say so.
"""

import argparse
import os
import tempfile
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path

from benchmarks.compare.comparison import Comparison
from benchmarks.compare.data import SCENES, scene_makers
from benchmarks.compare.isolated import Limits
from benchmarks.compare.measure import evaluation_options
from benchmarks.compare.method import Method
from benchmarks.compare.record import Record
from benchmarks.compare.registry import all_methods
from benchmarks.compare.results import Result
from benchmarks.compare.tables import tables
from benchmarks.density import machine

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> None:
    """Make the scenes, run the methods, print the tables."""
    parser = _parser()
    options = parser.parse_args(arguments)
    cores = sorted(os.sched_getaffinity(0))[-options.cores :]
    os.sched_setaffinity(0, cores)
    print(
        f"{machine()}; {len(cores)} cores; {datetime.now(UTC):%Y-%m-%d %H:%M} UTC; "
        f"seeds {options.seeds}; settings {options.set or 'none'}",
        flush=True,
    )
    print(tables(list(_results(options, _record(parser, options)))))


def _record(parser: argparse.ArgumentParser, options: argparse.Namespace) -> Record:
    if not options.resume:
        return Record(options.json)
    if options.json is None:
        parser.error("--resume needs --json, the file to go on with")
    try:
        return Record.resume(options.json)
    except ValueError as error:
        parser.error(str(error))


def _results(options: argparse.Namespace, record: Record) -> Iterator[Result]:
    methods = _chosen(options.methods)
    limits = Limits(options.seconds, options.memory)
    with tempfile.TemporaryDirectory() as folder:
        figures = evaluation_options(options.emd_points)
        comparison = Comparison(methods, limits, figures, folder, record, options.cores)
        for make in scene_makers(options.scenes, options.seeds, options.set, options.maps):
            for result in comparison.on(make()):
                said = result.skipped or ", ".join(
                    f"{name} {result.figures[name] or 0:.1f}" for name in ("SA", "DA", "AA", "s")
                )
                print(f"  {result.scene}: {result.method}: {said}", flush=True)
                yield result


def _chosen(beginnings: Sequence[str]) -> list[Method]:
    """Return the methods whose names begin like one of these; all, if there are none."""
    methods = all_methods()
    if not beginnings:
        return methods
    for beginning in beginnings:
        if not any(each.name.startswith(beginning) for each in methods):
            names = ", ".join(each.name for each in methods)
            raise SystemExit(f"--methods: none begins with {beginning!r}; there are {names}")
    return [each for each in methods if each.name.startswith(tuple(beginnings))]


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="benchmarks.compare",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("--scenes", nargs="+", choices=SCENES, default=["simulated-indoor"], metavar="SCENE")
    add("--seeds", nargs="+", type=int, default=[0], metavar="N", help="of simulated scenes")
    add("--set", nargs="+", default=[], metavar="KEY=VALUE", help="of the simulation")
    add("--maps", type=Path, default=Path("../shared/data/maps"), help="folder of recorded maps")
    add("--methods", nargs="+", default=[], metavar="NAME", help="beginnings of their names")
    add("--cores", type=int, default=1, help="that a method may use")
    add("--seconds", type=float, default=600.0, help="of processor time, that a method may take")
    add("--memory", type=float, default=8.0, help="that a method may take, GiB")
    add("--emd-points", type=int, default=2000, help="see `dynahull-pipeline evaluate`")
    add("--json", type=Path, metavar="FILE", help="write every figure, after each method")
    add(
        "--resume",
        action="store_true",
        help="reuse what the file has of the same data and settings",
    )
    return parser


if __name__ == "__main__":
    main()
