"""The configuration of a run: one YAML file, small models, unknown keys refused."""

from collections.abc import Sequence
from difflib import get_close_matches
from math import inf
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeVar

import numpy as np
import yaml
from numpy.typing import NDArray
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    Field,
    ValidationError,
    model_validator,
)

from dynahull.labels import Label
from dynahull.parameters import MethodParameters, validation_message
from pipeline.configuration.cluster import BATCH_SYSTEMS, BatchSystemName, ClusterParameters
from pipeline.configuration.quantities import Bytes, Size
from pipeline.errors import ConfigurationError

_NOT_YAML = (yaml.YAMLError, ValueError, RecursionError)
"""What PyYAML raises: ValueError for a date like 2024-13-45, RecursionError for deep brackets."""

NIGHTLY_EXAMPLE = "nightly.yaml"
"""Lies beside the ready configurations, and is none: it says what is cleaned every night."""

_FEW_POINTS = 20_000_000
"""Of a map whose labels are written unasked."""

Model = TypeVar("Model", bound=BaseModel)


class ExecutionParameters(BaseModel, extra="forbid", frozen=True):
    """How the work is spread over the machine; the result does not depend on it."""

    cluster: Literal["local", "none"] | BatchSystemName = Field(
        "local",
        description="Where tiles are worked on. `local`: a process for each worker, on this "
        "machine. `none`: this process, tile by tile. Others: jobs of this batch system, by the "
        "section `cluster`.",
    )
    scheduler: str | None = Field(
        None,
        description="Address of a running Dask scheduler whose workers are used, such as "
        "tcp://10.0.0.1:8786.",
    )
    workers: Annotated[int, Field(ge=1, strict=True)] | Literal["auto"] = Field(
        "auto",
        description="Workers, or threads of a map of one tile; `auto`: one for each available "
        "core.",
    )
    memory: Bytes | Literal["auto"] = Field(
        "auto",
        description="Memory of a worker, such as 2GiB; `auto`: its share of what is free. What "
        "takes more is refused before any work.",
    )


class TilingParameters(BaseModel, extra="forbid", frozen=True):
    """How a map is cut; the result does not depend on it."""

    max_points: Annotated[int, Field(ge=1)] | Literal["auto"] = Field(
        "auto",
        description="Most points of a tile, without its halo. A map of no more is cleaned in "
        "memory. `auto`: one tile where half of the free memory suffices; otherwise one to two "
        "million points, as memory and workers allow.",
    )
    halo: Annotated[float, Field(ge=0, allow_inf_nan=False)] | Literal["auto"] = Field(
        "auto",
        description="Width of the overlap around a tile, metres; `auto`: what most neighbours "
        "need, if few points lie there. Others are read from other tiles.",
    )
    format: Literal["parquet", "las", "laz"] = Field(
        "parquet",
        description="Of the chunks. `las` and `laz`: for maps whose coordinates lie on a grid.",
    )


Class = Annotated[int, Field(ge=0, le=255, strict=True)] | Literal["keep"]


class ClassParameters(BaseModel, extra="forbid", frozen=True):
    """Classes that points of each label get in a labelled LAS or LAZ map; `keep`: their own."""

    static: Class = Field("keep", description="Of what was scored and stays.")
    dynamic: Class = Field(
        7, description="Of what would be removed; 7 is noise (ASPRS), which LAS tools leave out."
    )
    ground: Class = Field(2, description="Of the ground; 2 is ground (ASPRS).")
    above: Class = Field("keep", description="Of what `max_height` sets aside.")
    unscored: Class = Field(
        "keep", description="Of noise, strays, and what is in a cluster of too few points."
    )
    invalid: Class = Field(
        "keep", description="Of points whose coordinates are not finite, or a heap at the origin."
    )

    def of_labels(self) -> dict[Label, int | None]:
        """Return the class of each label, None for the points' own."""
        given = {label: getattr(self, label.title) for label in Label}
        return {label: None if value == "keep" else value for label, value in given.items()}


class OutputParameters(BaseModel, extra="forbid", frozen=True):
    """What is written beside the cleaned map."""

    mode: Literal["split", "label"] = Field(
        "split",
        description="`split`: what stays and what goes, a file each. `label`: all points in one "
        "file, with the fields `label`, `density` and, with `auto`, `score`; LAS classes by "
        "`output.classes`.",
    )
    merge: bool = Field(
        False, description="Several files become one, in the map's frame; binary PCD, npy, KITTI's."
    )
    keep_work: bool = Field(
        False, description="Keep the work folder of a map of several tiles, with its chunks."
    )
    keep_free: Size = Field(
        0,
        description="Space on the disk that is left to others, such as 20GiB; a run that needs it "
        "is refused before any work.",
    )
    report: Literal["html", "none"] = Field(
        "html",
        description="`html`: write report.html, which shows offline what the run did.",
    )
    labels: bool | Literal["auto"] = Field(
        "auto",
        description="Write labels.parquet, from which `apply` decides again: label, cluster, "
        "density, score and reason of every point. `auto`: of maps of up to 20 million points.",
    )
    voxel: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = Field(
        None,
        description="Edge of voxels, metres: `thinned` holds of each the static point nearest to "
        "its middle.",
    )
    voxel_fields: Literal["nearest", "mean"] = Field(
        "nearest",
        description="Its fields. `nearest`: as they are. `mean`: quantities, coordinates too, are "
        "means over the voxel's static points in the same file; binary formats.",
    )
    classes: ClassParameters = ClassParameters()

    @property
    def needs_scores(self) -> bool:
        """Whether cluster and density of every point are kept until the outputs are written."""
        return bool(self.labels) or self.mode == "label"


AnyClass = Annotated[int, Field(ge=0, le=255, strict=True)]


def _absolute(path: str) -> str:
    """Return a name that means the same to workers, which may have another current folder."""
    return str(Path(path).absolute())


class InputParameters(BaseModel, extra="forbid", frozen=True):
    """How the map is understood."""

    unit: Literal["auto", "metre", "foot", "us_survey_foot"] = Field(
        "auto",
        description="Of the coordinates. `auto`: by the map's CRS, metres where it has none; "
        "degrees are refused. Lengths in this configuration are always metres; outputs keep the "
        "map's unit.",
    )
    poses: Annotated[str, AfterValidator(_absolute)] | None = Field(
        None,
        description="File of poses, of a folder of scans or of a map whose points have a scan "
        "number or a time: lines of 12 numbers (KITTI), 13 (the time first) or 8 (TUM). null: what "
        "lies beside the scans.",
    )
    frame: Literal["auto", "sensor", "map"] = Field(
        "auto", description="Of the points of scans with poses. `auto`: as their layout tells."
    )
    leave_out: tuple[AnyClass, ...] = Field(
        (7, 18),
        description="ASPRS classes (LAS, LAZ) that decide nothing and stay, `unscored`; 7 is low "
        "noise, 18 is high noise.",
    )
    leave_out_withheld: bool = Field(
        True, description="The same of points with the flag `withheld` (deleted)."
    )
    window: tuple[float, float, float, float] | None = Field(
        None,
        description="x0, y0, x1, y1, metres: points elsewhere stay. Those within 10 m still take "
        "part in the decision.",
    )
    height: tuple[float, float] | None = Field(
        None, description="z0, z1, metres: the same for lower and higher points."
    )

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        for axis, low, high in zip("xyz", self._low, self._high, strict=True):
            if not low < high:
                found = f"{axis} from {low:g} to {high:g}"
                raise ValueError(f"expected window and height lower number first, found {found}")
        return self

    @property
    def _low(self) -> tuple[float, ...]:
        return (*(self.window or (-inf,) * 2)[:2], (self.height or (-inf,))[0])

    @property
    def _high(self) -> tuple[float, ...]:
        return (*(self.window or (inf,) * 2)[-2:], (self.height or (inf,))[-1])

    @property
    def has_window(self) -> bool:
        """Whether a part of the map is cleaned alone."""
        return self.window is not None or self.height is not None

    def reaches(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> bool:
        """Tell whether a box, two corners (3,), meets the window."""
        return bool((high >= self._low).all() and (low < self._high).all())

    def in_window(self, xyz: NDArray[np.float64], margin: float = 0.0) -> NDArray[np.bool_]:
        """Tell which points lie in the window, or within a margin of it: low <= x, y, z < high."""
        low, high = np.array(self._low) - margin, np.array(self._high) + margin
        return np.asarray(((xyz >= low) & (xyz < high)).all(axis=1))


def _switch(value: Any) -> Any:
    """Return a word in place of what YAML takes it for: `off` is false there."""
    return "off" if value is False else value


class EvidenceParameters(BaseModel, extra="forbid", frozen=True):
    """What `removal.decision: auto` knows beside the points."""

    time: Annotated[str, Field(min_length=1), BeforeValidator(_switch)] = Field(
        "auto",
        description="When points were seen. `auto`: as a field or the order of the rows surely "
        "tells; a field's name; or `off`.",
    )


class Configuration(MethodParameters):
    """Everything a run can be told: the sections of the method, and those of the product."""

    evidence: EvidenceParameters = EvidenceParameters()
    input: InputParameters = InputParameters()
    tiling: TilingParameters = TilingParameters()
    execution: ExecutionParameters = ExecutionParameters()
    cluster: ClusterParameters = ClusterParameters()
    output: OutputParameters = OutputParameters()

    def method(self) -> MethodParameters:
        """Return the sections that `dynahull` knows."""
        return MethodParameters.model_validate(
            {name: getattr(self, name) for name in MethodParameters.model_fields}
        )

    def of_size(self, points: int) -> Self:
        """Return what holds for a map of so many points."""
        if self.output.labels != "auto":
            return self
        output = self.output.model_copy(update={"labels": points <= _FEW_POINTS})
        return self.model_copy(update={"output": output})

    def to_yaml(self) -> str:
        """Return the configuration as the YAML that `load_configuration` reads back."""
        return yaml.safe_dump(self.model_dump(mode="json"), sort_keys=False)


def is_elsewhere(configuration: Configuration) -> bool:
    """Tell whether workers are not processes of this machine that the run starts itself."""
    execution = configuration.execution
    return execution.scheduler is not None or execution.cluster in BATCH_SYSTEMS


def ready_configurations() -> dict[str, Path]:
    """Return the configurations that come with the product, by name."""
    files = sorted(configurations_folder().glob("*.yaml"))
    return {path.stem: path for path in files if path.name != NIGHTLY_EXAMPLE}


def configurations_folder() -> Path:
    """Return where the YAML files lie that come with the product."""
    # Within the package where it is installed, beside it in a checkout.
    here = Path(__file__).resolve().parents[1]
    return next(place for place in (here / "configs", here.parent / "configs") if place.is_dir())


def load_configuration(source: str | None, settings: Sequence[str] = ()) -> Configuration:
    """Read the configuration of a run and apply single settings to it.

    Parameters
    ----------
    source : str or None
        Path of a YAML file, or the name of a ready configuration (`indoor`); None for defaults.
    settings : sequence of str
        `section.key=value`, as given to `--set`; the value is YAML. Later ones win.

    Raises
    ------
    ConfigurationError
        In one line: where, what was found, and what is allowed.
    """
    return load_parameters(Configuration, source, settings)


def load_parameters(model: type[Model], source: str | None, settings: Sequence[str] = ()) -> Model:
    """Read any model as `load_configuration` reads the configuration of a run."""
    if source == "":
        raise ConfigurationError("-c: expected a file or a name, found nothing")
    values = _read_yaml(source) if source else {}
    for setting in settings:
        _apply(setting, values)
    for name, field in model.model_fields.items():
        kind = field.annotation
        is_section = isinstance(kind, type) and issubclass(kind, BaseModel)
        if is_section and values.get(name, ...) is None:
            del values[name]  # all of its keys are commented out
    try:
        return model.model_validate(values)
    except ValidationError as error:
        if settings:
            load_parameters(model, source)  # where the file itself is wrong, it says so
        named = "configuration" if settings or not source else source
        raise ConfigurationError(f"{named}: {validation_message(error, model)}") from None


def _read_yaml(source: str) -> dict[str, Any]:
    path, ready = Path(source), ready_configurations()
    if not path.is_file():
        path = ready.get(source, path)
    try:
        values = yaml.safe_load(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        alike = get_close_matches(str(path), ready, n=1)
        hint = f"; did you mean {alike[0]}?" if alike else ""
        raise ConfigurationError(
            f"{path}: expected a YAML file or one of the ready configurations "
            f"({', '.join(ready)}), found no such file{hint}"
        ) from None
    except UnicodeDecodeError:
        raise ConfigurationError(f"{path}: expected a YAML file, found no text") from None
    except OSError as error:
        found = "a folder" if path.is_dir() else error.strerror or error
        raise ConfigurationError(f"{path}: expected a YAML file, found {found}") from None
    except _NOT_YAML as error:
        mark = getattr(error, "problem_mark", None)
        place = f" at line {mark.line + 1}" if mark else ""
        problem = getattr(error, "problem", None) or "something else"
        raise ConfigurationError(f"{path}: not YAML{place}: {problem}") from None
    if values is None:
        return {}
    if not isinstance(values, dict):
        raise ConfigurationError(f"{path}: expected sections with keys, found {values!r:.60}")
    return values


def _apply(setting: str, values: dict[str, Any]) -> None:
    """Set one `section.key=value` in nested dictionaries."""
    key, equals, text = setting.partition("=")
    if not equals or not key:
        raise ConfigurationError(f"--set {setting}: expected section.key=value")
    try:
        value = yaml.safe_load(text)
    except _NOT_YAML:
        raise ConfigurationError(
            f"--set {setting}: expected a YAML value, found {text!r}"
        ) from None
    *sections, name = key.split(".")
    for section in sections:
        values = values.setdefault(section, {})
        if not isinstance(values, dict):
            raise ConfigurationError(f"--set {setting}: {section} is a value, not a section")
    values[name] = value
