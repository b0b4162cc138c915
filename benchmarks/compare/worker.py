"""One method on one scene, in a process of its own: `python -m benchmarks.compare.worker`.

A peer that runs out of memory or of time, or takes the interpreter down, is a row of the table and
not the end of the comparison.
"""

import argparse
import json
import resource
from pathlib import Path
from time import perf_counter

import numpy as np

from benchmarks.compare.method import Unavailable
from benchmarks.compare.registry import all_methods
from benchmarks.compare.scene import Scene

__all__ = ["main"]


def main() -> None:
    """Run the method, and write what it removes and what it took."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("method", help="its name")
    parser.add_argument("scene", type=Path, help="as Scene.write wrote it")
    parser.add_argument("removed", type=Path, help="where to write the removed points, NPY")
    parser.add_argument("report", type=Path, help="where to write the rest, JSON")
    parser.add_argument("--memory", type=float, required=True, help="most, GiB")
    arguments = parser.parse_args()
    (method,) = (each for each in all_methods() if each.name == arguments.method)
    limit = int(arguments.memory * 2**30)
    resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))
    try:
        remove = method.load()
        scene = Scene.read(arguments.scene)
        begun = perf_counter()
        removed = np.asarray(remove(scene), dtype=np.bool_)
        seconds = perf_counter() - begun
    except Unavailable as reason:
        arguments.report.write_text(json.dumps({"skipped": str(reason)}), encoding="utf-8")
        return
    except MemoryError:
        told = {"skipped": f"more than {arguments.memory:g} GiB of memory"}
        arguments.report.write_text(json.dumps(told), encoding="utf-8")
        return
    if removed.shape != (len(scene),):
        raise ValueError(f"expected a decision for {len(scene)} points, found {removed.shape}")
    np.save(arguments.removed, removed)
    arguments.report.write_text(json.dumps({"seconds": seconds}), encoding="utf-8")


if __name__ == "__main__":
    main()
