"""What a run did, as `run.json` and as the lines printed at its end."""

import json
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import BaseModel, SkipValidation

from dynahull.result import ClusterSummary
from pipeline.configuration.run import Configuration, is_elsewhere
from pipeline.errors import OutputError
from pipeline.metres import of_map
from pipeline.outputs.folder import OutputNames
from pipeline.places import Decision, Place
from pipeline.plan.machine import available_cores, peak_memory, peak_of_workers
from pipeline.progress import StageObserver
from pipeline.replacing import LABELS_FILE, REPORT_FILE, RUN_FILE, no_result
from pipeline.showing import printable
from tiling.collection import MapCollection

FileName = Annotated[str, SkipValidation]
"""Any name that the system has: pydantic's own text is UTF-8 alone."""


class InputFile(BaseModel):
    """One file of the map, and the names of what became of it in the output folder.

    Of a scan that lies in its sensor's frame `pose` is the matrix to the map's, row by row.
    """

    path: FileName
    format: str
    size_bytes: int
    points: int
    first_row: int
    static: FileName | None = None
    dynamic: FileName | None = None
    labelled: FileName | None = None
    pose: list[float] | None = None

    @property
    def outputs(self) -> list[str]:
        """The files written of it."""
        return [name for name in (self.static, self.dynamic, self.labelled) if name is not None]


class ClusterReport(BaseModel):
    """Eq. 1 for one cluster: N_i, R_i in percent, the threshold, and the points removed."""

    index: int
    centroid: tuple[float, float, float]
    count: int
    removal_percent: float
    threshold: float | None
    removed: int

    @classmethod
    def of(cls, summary: ClusterSummary) -> "ClusterReport":
        """Take over what the method says of a cluster."""
        return cls(
            index=summary.index,
            centroid=summary.centroid,
            count=summary.count,
            removal_percent=summary.percentage,
            threshold=summary.threshold,
            removed=summary.removed,
        )


class RunReport(BaseModel, frozen=True):
    """Everything a run has to say."""

    version: str
    """Of this product."""
    finished: str
    """Date and time, UTC, ISO 8601."""
    output: FileName
    """The output folder."""
    outputs: list[FileName]
    """The files written into it."""
    input_hash: str
    """SHA-256 over the bytes of the input files, in order."""
    poses_hash: str | None = None
    """SHA-256 over the poses of its scans, if they are known."""
    files: list[InputFile]
    """The map's files, and the names of what became of each."""
    points: int
    """Points of the whole map."""
    counts: dict[str, int]
    """Points of each label; they add up to `points`."""
    clusters: list[ClusterReport]
    places: list[Place] = []
    """Where points were removed, the places of most points first."""
    place_count: int | None = None
    """All places, also those that are not listed; None in reports of old."""
    scattered_points: int | None = None
    """Removed points that are in no place."""
    uncertain_points: int | None = None
    """Points kept, though at least half as likely to have moved as those that go; None where the
    evidence was not asked."""
    seconds: dict[str, float]
    """Wall time of each stage."""
    peak_memory_bytes: int
    """Of this process."""
    peak_memory_all_bytes: int | None = None
    """Of this process and its workers together, at most: each is taken to be as large as the
    largest. None where workers are on other machines."""
    warnings: list[FileName]
    system: str = ""
    """Coordinate reference system and unit of the map, in words."""
    time: str | None = None
    """What told when points were seen, in words; None where the evidence was not asked."""
    configuration: dict[str, Any]
    """As resolved; the same as in `config.yaml`."""

    @classmethod
    def read(cls, folder: Path) -> Self:
        """Read what a finished run left in its folder.

        Raises
        ------
        OutputError
            When there is no such file, or it is not the report of a run.
        """
        try:
            return cls.model_validate(json.loads((folder / RUN_FILE).read_text(encoding="utf-8")))
        except (OSError, ValueError):
            raise OutputError(no_result(folder)) from None

    @classmethod
    def of(
        cls,
        folder: Path,
        collection: MapCollection,
        input_hash: str,
        configuration: Configuration,
        counts: dict[str, int],
        clusters: Sequence[ClusterSummary],
        decision: Decision,
        time: str | None,
        names: OutputNames,
        observer: StageObserver,
    ) -> "RunReport":
        """Gather the report of a finished run."""
        return cls(
            version=version("dynahull-pipeline"),
            finished=datetime.now(UTC).isoformat(timespec="seconds"),
            output=str(folder),
            outputs=[str(name) for name in names.all_files(configuration.output)],
            input_hash=input_hash,
            poses_hash=None if collection.poses is None else collection.poses.hashed(),
            files=_input_files(collection, names),
            points=collection.point_count,
            counts=counts,
            clusters=[ClusterReport.of(cluster) for cluster in clusters],
            places=list(decision.places),
            place_count=decision.place_count,
            scattered_points=decision.scattered,
            uncertain_points=decision.uncertain if configuration.removal.weighs_evidence else None,
            seconds=_seconds(observer),
            peak_memory_bytes=peak_memory(),
            peak_memory_all_bytes=_peak_of_all(configuration, observer),
            warnings=list(observer.warnings),
            system=of_map(collection, configuration.input),
            time=time,
            configuration=configuration.model_dump(mode="json"),
        )

    def with_seconds(self, observer: StageObserver) -> Self:
        """Return the report with the stages and warnings there are now."""
        now = {"seconds": _seconds(observer), "warnings": list(observer.warnings)}
        return self.model_copy(update=now)

    def without_page(self) -> Self:
        """Return the report of a run whose page could not be made."""
        return self.model_copy(
            update={"outputs": [name for name in self.outputs if name != REPORT_FILE]}
        )

    def to_json(self) -> str:
        """Return the text of `run.json`."""
        return json.dumps(self.model_dump(mode="json"), indent=2) + "\n"

    def summary(self) -> str:
        """Return the lines printed at the end of a run."""
        removed = self.counts["dynamic"]
        share = share_of(removed, self.points) if removed else "0.0 %"
        kept = ", ".join(
            f"{count:,} {label}"
            for label, count in self.counts.items()
            if count and label != "dynamic"
        )
        lines = [
            f"{removed:,} of {self.points:,} points removed ({share})",
            f"kept: {kept or 'nothing'}",
        ]
        if not self.system.startswith("none, metres"):
            lines.append(f"coordinates: {self.system}")
        if self.time not in (None, "none"):
            lines.append(f"time: {self.time}")
        lines += self._by_cluster()
        folder = Path(self.output)
        names = [name for file in self.files for name in file.outputs]
        names += [name for name in self.outputs if Path(name).parts[0].startswith("thinned")]
        written = [folder / each for each in dict.fromkeys(Path(name).parts[0] for name in names)]
        if self.configuration["output"]["labels"]:
            written.append(folder / LABELS_FILE)
        if REPORT_FILE in self.outputs:
            written.append(folder / REPORT_FILE)
        lines.append(
            "written: " + ", ".join(printable(path) for path in [*written, folder / RUN_FILE])
        )
        return "\n".join([*lines, *self.verdict()])

    def _by_cluster(self) -> list[str]:
        """Return a table of what each cluster lost; `auto` looks at no R_i and no threshold."""
        equation = self.configuration["removal"]["decision"] == "paper"
        titles = f"{'R_i':>9}{'threshold':>14}" if equation else ""
        lines = [f"{'cluster':>9}{'points':>14}{titles}{'removed':>12}"] if self.clusters else []
        for cluster in self.clusters:
            threshold = "-" if cluster.threshold is None else f"{cluster.threshold:.4g}"
            shares = f"{cluster.removal_percent:>7.2f} %{threshold:>14}" if equation else ""
            lines.append(f"{cluster.index:>9}{cluster.count:>14,}{shares}{cluster.removed:>12,}")
        return lines

    def verdict(self) -> list[str]:
        """Return what was decided, in a line or two."""
        if self.place_count is None:
            return []
        removed = self.counts["dynamic"]
        if not removed + self.counts["static"]:
            return ["nothing was scored: nothing removed"]
        kept = ""
        if self.uncertain_points:
            kept = f"; {share_of(self.uncertain_points, self.points)} uncertain, kept"
        if not removed:
            moved = "" if self.uncertain_points is None else "nothing moved: "
            return [f"{moved}nothing removed{kept}"]
        where = []
        if self.place_count:
            where.append(_counted(self.place_count, "place"))
        if self.scattered_points:
            where.append(_counted(self.scattered_points, "scattered point"))
        lines = [f"{share_of(removed, self.points)} removed in {' and '.join(where)}{kept}"]
        if self.places:
            place = self.places[0]
            at = ", ".join(f"{value:,.1f}" for value in place.middle)
            size = " x ".join(f"{value:.1f}" for value in place.size)
            why = place.reasons[0]
            lines.append(
                f"largest place: {place.points:,} points about ({at}), {size} m: "
                f"{why.words} ({100 * why.share:.0f} %)"
            )
        return lines


def _counted(count: int, what: str) -> str:
    return f"{count:,} {what}" + ("" if count == 1 else "s")


def share_of(part: int, whole: int) -> str:
    """Return a share in percent; one that is not nothing does not look like nothing."""
    percent = 100 * part / whole
    return "under 0.1 %" if percent < 0.1 else f"{percent:.1f} %"


def _peak_of_all(configuration: Configuration, observer: StageObserver) -> int | None:
    """Return what this process and its workers held at most; None where they are elsewhere."""
    if "label" not in observer.seconds or configuration.execution.cluster == "none":
        return peak_memory()  # no work was shared out
    if is_elsewhere(configuration):
        return None
    return peak_memory() + available_cores(configuration.execution.workers) * peak_of_workers()


def _seconds(observer: StageObserver) -> dict[str, float]:
    return {stage: round(seconds, 3) for stage, seconds in observer.seconds.items()}


def _input_files(collection: MapCollection, names: OutputNames) -> list[InputFile]:
    return [
        InputFile(
            path=str(reader.description.path.resolve()),
            format=reader.description.format,
            size_bytes=reader.description.path.stat().st_size,
            points=reader.description.point_count,
            first_row=first_row,
            pose=_pose(collection, number) if len(names.by_file) > 1 else None,
            **{kind: str(files[number % len(files)]) for kind, files in names.by_kind.items()},
        )
        for number, (reader, first_row) in enumerate(
            zip(collection.readers, collection.first_rows, strict=True)
        )
    ]


def _pose(collection: MapCollection, file: int) -> list[float] | None:
    """Return where the points of a file's outputs lie in the map, if they lie elsewhere."""
    if collection.poses is None or not collection.is_moved:
        return None
    return [float(value) for value in collection.poses.poses[file].ravel()]
