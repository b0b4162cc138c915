"""The evaluation of a cleaned map: what is static, how far the map is from it, who is to blame.

Memory does not grow with the maps: all of them are first cut by place into tiles on the disk, and
then gone through tile by tile. Each map is read twice, in batches; what is found out about a point
is written beside it. No figure depends on how the maps are cut, to the last bit.
"""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from dynahull.observer import Observer
from pipeline.errors import DiskSpaceError, EvaluationError, MissingPackageError
from pipeline.evaluation.distances import (
    Geometry,
    check_transport,
    compare_geometry,
    transport_library,
)
from pipeline.evaluation.inputs import EvaluationInputs, EvaluationOptions
from pipeline.evaluation.picture import draw_picture
from pipeline.evaluation.scoring import Scores, label_by_map, label_cleaned, score
from pipeline.evaluation.tiled_cloud import (
    POINT_BYTES,
    CloudSource,
    TiledCloud,
    check_points,
    cut_clouds,
    distance_apart,
)
from pipeline.evaluation.truth import Truth
from pipeline.plan.resources import check_space
from pipeline.showing import only_showing
from pipeline.temporary import temporary_folder
from tiling.collection import MapCollection

_MORE_BYTES = 25
"""On the disk, a point of the cleaned map at most: its distance, or the mean of its voxel."""


class Figures(NamedTuple):
    """All figures; `scores` is None where there is no original map."""

    geometry: Geometry
    scores: Scores | None


def evaluate(
    inputs: EvaluationInputs,
    options: EvaluationOptions,
    observer: Observer,
    picture: Path | None = None,
) -> Figures:
    """Compare a cleaned map with the truth; `picture` is where to draw the decisions.

    Raises
    ------
    DiskSpaceError
        When the folder for temporary files has no room.
    EvaluationError
        When a map, or what of it can be compared, has no finite point.
    PlanError
        When it would take more memory than there is.
    TilingError
        When a map cannot be read.
    """
    sources = _sources(inputs)
    if options.emd_points:  # before the work, not after it
        try:
            transport_library()
        except MissingPackageError as error:
            observer.warn(f"{error}; all else is measured")
            options = options.model_copy(update={"emd_points": 0})
    if options.emd_points:
        counts = {name: each.collection.point_count for name, each in sources.items()}
        reference = "truth" if "truth" in counts else "original"
        check_transport(options.emd_points, counts["cleaned"], counts[reference])
    _check_disk([source.collection for source in sources.values()])
    with TemporaryDirectory(prefix="evaluate-", dir=temporary_folder()) as name:
        folder = Path(name)
        clouds = cut_clouds(sources, options.voxel, folder, observer)
        return _compare(clouds, inputs, options, folder, observer, picture)


def _compare(
    clouds: dict[str, TiledCloud],
    inputs: EvaluationInputs,
    options: EvaluationOptions,
    folder: Path,
    observer: Observer,
    picture: Path | None,
) -> Figures:
    cleaned, truth, original = clouds["cleaned"], clouds.get("truth"), clouds.get("original")
    if original is None:
        assert truth is not None
        if apart := distance_apart(cleaned, truth):
            observer.warn(
                f"{cleaned.name} lies {apart:g} m from {truth.name}: are they in the same "
                "coordinates?"
            )
        return Figures(compare_geometry(cleaned, truth, options, folder, observer), None)
    if truth is not None:
        if apart := distance_apart(truth, original):  # in which nothing of it can be static
            raise EvaluationError(
                f"{truth.name}: expected a map of the same place as {original.name}, found it "
                f"{apart:g} m away: are they in the same coordinates?"
            )
        label_by_map(original, truth, options, observer)
    else:
        truth = original.choose(Truth.STATIC)
    _check_labels(original, observer)
    # Where nobody knows what is true, nothing is compared.
    label_cleaned(cleaned, original, options, observer)
    cleaned = cleaned.choose(Truth.STATIC, Truth.DYNAMIC)
    check_points(cleaned, " among those that are to be compared")
    geometry = compare_geometry(cleaned, truth, options, folder, observer)
    scores = score(cleaned, original, inputs.removed is not None, options, folder, observer)
    if picture is not None:
        with only_showing(str(picture), observer.warn):
            draw_picture(original, picture, observer)
    return Figures(geometry, scores)


def _sources(inputs: EvaluationInputs) -> dict[str, CloudSource]:
    """Return the maps to cut. What the original is labelled by a map for is not known yet."""
    sources = {"cleaned": CloudSource(inputs.cleaned, chosen=inputs.kept)}
    if inputs.truth is not None:
        sources["truth"] = CloudSource(inputs.truth)
    if inputs.original is not None:
        sources["original"] = CloudSource(
            inputs.original, labels=inputs.labels, removed=inputs.removed
        )
    return sources


def _check_disk(collections: list[MapCollection]) -> None:
    """Refuse maps that the folder for temporary files has no room for, cut into tiles."""
    temporary = POINT_BYTES * sum(each.point_count for each in collections)
    temporary += _MORE_BYTES * max(each.point_count for each in collections)
    try:
        check_space(temporary_folder(), temporary, 0, 0)
    except DiskSpaceError as error:
        raise DiskSpaceError(f"{error} (TMPDIR names another folder)") from None


def _check_labels(original: TiledCloud, observer: Observer) -> None:
    """Refuse labels without a static point, and warn of labels without one that moved."""
    if not len(original.choose(Truth.STATIC)):
        raise EvaluationError(
            f"{original.name}: expected points that are static in truth, found none "
            "(--dynamic, --unlabelled and --truth-tolerance say which are)"
        )
    if not len(original.choose(Truth.DYNAMIC)):
        observer.warn(f"{original.name}: no point moved in truth: recall, DA and RR are undefined")
