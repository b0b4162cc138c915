"""All methods on one scene after the other; peers are first shown to work on an easy one."""

from collections.abc import Iterator, Sequence
from hashlib import blake2b
from pathlib import Path

import numpy as np

from benchmarks.compare.data.crossing import crossing_scene
from benchmarks.compare.data.strays import strays_scene
from benchmarks.compare.isolated import Limits, Outcome, run_isolated
from benchmarks.compare.measure import measure
from benchmarks.compare.method import Family, Method
from benchmarks.compare.record import Record
from benchmarks.compare.results import Result
from benchmarks.compare.scene import Scene
from pipeline.errors import EvaluationError
from pipeline.evaluation.inputs import EvaluationOptions
from pipeline.evaluation.truth import Truth

__all__ = ["Comparison"]

LEAST_FOUND, MOST_LOST = 0.7, 0.25
"""Of a thing that crosses an empty hall, and of the hall: see `data.crossing`. The foot of the
thing is as near to the floor as a voxel, and OctoMap is known to wear floors away. The same of
points above a floor, and of the floor: see `data.strays`."""

_EASY = {
    Family.SCANS: "of a thing that crosses an empty hall and loses {:.0%} of the hall",
    Family.MAP: "of single points above a dense floor and loses {:.0%} of the floor",
}
"""What must be found, by what a method needs."""


class Comparison:
    """Runs methods on scenes.

    Parameters
    ----------
    methods : sequence of Method
    limits : Limits
        For each run of a method.
    options : EvaluationOptions
    folder : str or Path
        For files in between.
    record : Record, optional
        Of what is finished already; results are added to it.
    cores : int
        That this process and its children may use.
    crossing : Scene, optional
        Where peers that need scans and poses are shown to work; those that have the map only are on
        `data.strays`.
    """

    def __init__(
        self,
        methods: Sequence[Method],
        limits: Limits,
        options: EvaluationOptions,
        folder: str | Path,
        record: Record | None = None,
        cores: int = 1,
        crossing: Scene | None = None,
    ) -> None:
        self._methods = methods
        self._limits = limits
        self._options = options
        self._folder = Path(folder)
        self._record = record or Record()
        self._cores = cores
        self._easy = {Family.SCANS: crossing or crossing_scene(), Family.MAP: strays_scene()}
        self._reasons: dict[str, str | None] = {}

    def on(self, scene: Scene) -> Iterator[Result]:
        """Yield the result of every method on a scene."""
        path = self._folder / "scene.npz"
        scene.write(path)
        digest = scene.digest()
        for method in self._methods:
            key = self._key(method, digest)
            result = self._record.finished(key)
            if result is None:
                result = self._result(method, scene, path, key)
                self._record.add(result)
            yield result

    def _key(self, method: Method, digest: str) -> str:
        of_method = method.name, method.parameters, method.version()
        settings = (digest, *of_method, self._limits, self._options)
        return blake2b(repr((*settings, self._cores)).encode(), digest_size=16).hexdigest()

    def _result(self, method: Method, scene: Scene, path: Path, key: str) -> Result:
        outcome = self._run(method, path)
        skipped, figures = outcome.skipped, {}
        if skipped is None:
            try:
                evaluated = measure(scene, outcome.removed, self._options, self._folder)
                figures = Result.figures_of(outcome, evaluated)
            except EvaluationError as error:
                skipped = str(error)
        return Result(
            method=method.name,
            family=method.family.value,
            scene=scene.name,
            group=scene.group,
            points=len(scene),
            skipped=skipped,
            exhausted=outcome.exhausted,
            figures=figures,
            key=key,
        )

    def _run(self, method: Method, scene: Path) -> Outcome:
        if method.family in self._easy:
            if method.name not in self._reasons:
                self._reasons[method.name] = self._why_not(method)
            reason = self._reasons[method.name]
            if reason is not None:
                return Outcome.skip(reason)
        outcome = run_isolated(method, scene, self._folder, self._limits)
        if method.family is Family.SCANS and outcome.skipped is None and not outcome.removed.any():
            return Outcome.skip("removed nothing here: called wrongly until shown otherwise")
        return outcome

    def _why_not(self, method: Method) -> str | None:
        """Return why a method is not trusted with a scene; None if it works on the easy one."""
        scene = self._easy[method.family]
        path = self._folder / f"{scene.name}.npz"
        scene.write(path)
        outcome = run_isolated(method, path, self._folder, self._limits)
        if outcome.skipped is not None:
            return outcome.skipped
        moved = scene.labels == Truth.DYNAMIC
        found = float(np.mean(outcome.removed[moved]))
        lost = float(np.mean(outcome.removed[~moved]))
        if found >= LEAST_FOUND and lost <= MOST_LOST:
            return None
        what = _EASY[method.family].format(lost)
        return f"finds {found:.0%} {what}: called wrongly, or not made for such maps"
