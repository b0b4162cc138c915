"""One method on one scene, in a process of its own: `python -m benchmarks.compare.worker`.

A peer that runs out of memory or of time, or takes the interpreter down, is a row of the table and
not the end of the comparison.
"""

import argparse
import json
import math
import os
import resource
from pathlib import Path

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
    parser.add_argument("--seconds", type=float, required=True, help="most, of processor time")
    arguments = parser.parse_args()
    (method,) = (each for each in all_methods() if each.name == arguments.method)
    _limit(resource.RLIMIT_DATA, int(arguments.memory * 2**30))
    _limit(resource.RLIMIT_CPU, math.ceil(arguments.seconds))
    try:
        remove = method.load()
        scene = Scene.read(arguments.scene)
        begun = _processor_seconds()
        removed = np.asarray(remove(scene), dtype=np.bool_)
        told: dict[str, object] = {"seconds": _processor_seconds() - begun}
    except Unavailable as reason:
        told = {"skipped": str(reason), "exhausted": False}
    except MemoryError:
        told = {"skipped": f"more than {arguments.memory:g} GiB of memory", "exhausted": True}
    else:
        if removed.shape != (len(scene),):
            raise ValueError(f"expected a decision for {len(scene)} points, found {removed.shape}")
        np.save(arguments.removed, removed)
    arguments.report.write_text(json.dumps(told), encoding="utf-8")


def _limit(what: int, most: int) -> None:
    """Set the limit at which the system sends a signal or gives no more."""
    _, hard = resource.getrlimit(what)
    resource.setrlimit(what, (most, hard))


def _processor_seconds() -> float:
    """Return what this process and those it waited for took, in all threads, user and system."""
    return sum(os.times()[:4])


if __name__ == "__main__":
    main()
