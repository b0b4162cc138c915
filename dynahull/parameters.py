"""Parameters of the method, one small model a step; the same names in YAML and in Python."""

from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from types import MappingProxyType
from typing import Annotated, Any, Literal, Self, get_args

from pydantic import BaseModel, Field, ValidationError, model_validator

from dynahull.errors import InvalidParametersError
from dynahull.ground.parameters import GroundParameters
from dynahull.protection import Area

__all__ = [
    "READY",
    "ClusteringParameters",
    "DensityParameters",
    "GroundParameters",
    "MethodParameters",
    "NeighbourParameters",
    "RemovalParameters",
    "validation_message",
]


READY: Mapping[str, Mapping[str, Any]] = MappingProxyType(
    {
        "auto": {"removal": {"decision": "auto"}},
        "paper": {"removal": {"decision": "paper"}},
        "indoor": {"max_height": 2.5, "removal": {"decision": "paper"}},
        "outdoor": {
            "removal": {"decision": "paper"},
            "ground": {
                "method": "slope",
                "slope": {
                    "clearance": None,
                    "window": 18.0,
                    "slope": 0.2,
                    "step": 0.0,
                    "steepest": 100.0,
                    "expert": {
                        "cell": 1.5,
                        "flatness": 0.3,
                        "continuity": 2.0,
                        "extension": 10.0,
                        "tolerance": 0.25,
                        "noise_tolerance": 0.75,
                        "slope_tolerance": 1.25,
                        "tolerance_limit": 100.0,
                    },
                },
            },
        },
    }
)
"""The ready parameters, by name: sections that differ from the defaults. `configs/` has them with
what a run of the product needs."""


_OF_EQUATION = {"min_percent", "max_percent", "threshold"}
"""Keys of `removal` that Eq. 1 alone looks at."""


class ClusteringParameters(BaseModel, extra="forbid", frozen=True):
    """MiniBatchKMeans on the ground-free points."""

    count: int = Field(5, ge=1, le=10_000, description="Number of clusters.")
    scope: Literal["map", "tile"] = Field(
        "map",
        description="`map`: one model for the whole map. `tile`: one for each tile (in memory, the "
        "map), where a map is too large for a few clusters.",
    )
    seed: int = Field(0, ge=0, lt=2**32, description="Seed of the sample and of the model.")
    sample: int = Field(
        100_000,
        ge=1_000,
        description="Points drawn from the map by row number, ground included; the model is fitted "
        "on those of them that are scored.",
    )


class NeighbourParameters(BaseModel, extra="forbid", frozen=True):
    """The neighbourhood whose hull is measured."""

    k: int = Field(75, ge=4, le=1_000, description="Nearest neighbours, the point itself included.")


class DensityParameters(BaseModel, extra="forbid", frozen=True):
    """Where and how k / v is computed."""

    device: Literal["cpu", "reference"] = Field(
        "cpu",
        description="`cpu`: compiled kernels. `reference`: the plain version that they are tested "
        "against, by SciPy's k-d tree and Qhull, some twenty times slower.",
    )


class RemovalParameters(BaseModel, extra="forbid", frozen=True):
    """How it is decided what goes: by the paper's share of each cluster (Eq. 1), or by evidence."""

    decision: Literal["auto", "paper"] = Field(
        "auto",
        description="`auto`: what the evidence says moved. `paper`: the least dense points of each "
        "cluster, as many as Eq. 1 says; the default where a key of Eq. 1 (`min_percent`, "
        "`max_percent`, `threshold`) is given.",
    )
    confidence: Annotated[float, Field(gt=0, lt=1)] = Field(
        0.5,
        description="Of `auto`: least probability of having moved at which a point goes. Higher is "
        "more careful.",
    )
    min_percent: float = Field(
        5.0, ge=0, le=100, description="Percent removed from the smallest cluster."
    )
    max_percent: float = Field(
        20.0, ge=0, le=100, description="Percent removed from the largest cluster."
    )
    threshold: Literal["rank", "stepped"] = Field(
        "rank",
        description="`rank`: exactly the share R_i, least dense first. `stepped`: the threshold "
        "rises in equal steps until R_i is reached, as the paper words it.",
    )

    protect_classes: tuple[Annotated[int, Field(ge=0, le=255, strict=True)], ...] = Field(
        (), description="ASPRS classes that are never removed (LAS, LAZ)."
    )
    protect: tuple[Area, ...] = Field(
        (),
        description="Areas in which nothing is removed: polygons from above, `rings` of corners, "
        "between the heights `low` and `high`. `--protect FILE` reads them.",
    )

    @model_validator(mode="before")
    @classmethod
    def _decided_by_what_is_given(cls, given: Any) -> Any:
        if isinstance(given, Mapping) and "decision" not in given and _OF_EQUATION & given.keys():
            return {**given, "decision": "paper"}
        return given

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.min_percent > self.max_percent:
            raise ValueError(
                f"min_percent ({self.min_percent:g}) is above max_percent "
                f"({self.max_percent:g}): set removal.min_percent as well, to no more than "
                f"{self.max_percent:g}"
            )
        return self

    @property
    def weighs_evidence(self) -> bool:
        """Whether each point is judged by the evidence for it."""
        return self.decision == "auto"


class MethodParameters(BaseModel, extra="forbid", frozen=True):
    """All parameters of the method, by the steps of Algorithm 1.

    The defaults are those of the paper (k = 75, five clusters), but for what goes: points that more
    likely moved than not, by the evidence.
    """

    ground: GroundParameters = GroundParameters()
    max_height: float | None = Field(
        None,
        gt=0,
        description="Metres above the local ground; higher points stay, unscored. null: no limit.",
    )
    clustering: ClusteringParameters = ClusteringParameters()
    neighbours: NeighbourParameters = NeighbourParameters()
    density: DensityParameters = DensityParameters()
    removal: RemovalParameters = RemovalParameters()

    @property
    def needs_heights(self) -> bool:
        """Whether the height of points above the local ground decides anything."""
        return self.max_height is not None or self.removal.weighs_evidence

    @classmethod
    def chosen(
        cls, given: "MethodParameters | Mapping[str, Any] | str | None", sections: Mapping[str, Any]
    ) -> "MethodParameters":
        """Return what is given, whole or by name, with the keys of sections in place of its own.

        Raises
        ------
        InvalidParametersError
            When there is nothing of that name, or a name or a value is not allowed.
        """
        if isinstance(given, str):
            if given not in READY:
                raise InvalidParametersError(
                    f"parameters: expected the name of a ready configuration ({', '.join(READY)}), "
                    f"found {given!r:.200}; the command line reads files"
                )
            given = READY[given]
        if isinstance(given, MethodParameters):
            if not sections:
                return given
            given = {name: getattr(given, name) for name in MethodParameters.model_fields}
        if given is not None and not isinstance(given, Mapping):
            raise InvalidParametersError(
                "parameters: expected MethodParameters, a dictionary of sections, or the name of "
                f"a ready configuration ({', '.join(READY)}), found an object of type "
                f"{type(given).__name__}"
            )
        own = given or {}
        return cls.of({**own, **{name: _over(own.get(name), sections[name]) for name in sections}})

    @classmethod
    def of(cls, sections: dict[str, Any]) -> Self:
        """Build from sections given as models or as plain dictionaries.

        Raises
        ------
        InvalidParametersError
            When a name or a value is not allowed.
        """
        try:
            return cls.model_validate(sections)
        except ValidationError as error:
            raise InvalidParametersError(validation_message(error, cls)) from error


def _over(own: Any, given: Any) -> Any:
    """Return a section with the keys that are given in place of its own."""
    if isinstance(own, BaseModel):
        own = own.model_dump()
    if isinstance(own, Mapping) and isinstance(given, Mapping):
        return {**own, **given}
    return given


def validation_message(invalid: ValidationError, model: type[BaseModel]) -> str:
    """Say what a model refused in one line, with the nearest allowed name where a key is unknown.

    The first error is told; an unknown key before all others, as a key that is misspelt may be
    missing as well.
    """
    errors = invalid.errors()
    error = next((each for each in errors if each["type"] == "extra_forbidden"), errors[0])
    where = error["loc"]
    if error["type"] == "extra_forbidden":
        return f"{_path(where)}: no such key; {_hint(where, model)}"
    if error["type"] == "model_type":
        keys = ", ".join(_allowed_keys(where, model))
        return f"{_path(where)}: expected a section of keys ({keys}), found {error['input']!r}"
    # pydantic names the kinds that a value may have as if they were keys.
    place = _without_kinds(where, model)
    message = error["msg"].removeprefix("Value error, ")
    words = [
        f"or {each['ctx']['expected']}"
        for each in errors[1:]
        if each["type"] == "literal_error" and _without_kinds(each["loc"], model) == place
    ]
    told = ", ".join([f"{message[:1].lower()}{message[1:]}", *words])
    found = "" if isinstance(error["input"], dict) else f", found {error['input']!r}"
    return f"{_path(place) or 'parameters'}: {told}{found}"


def _path(place: Sequence[int | str]) -> str:
    return ".".join(map(str, place))


def _hint(place: Sequence[int | str], model: type[BaseModel]) -> str:
    """Say which keys are allowed, and which one was meant: the nearest, or one of this name."""
    *sections, name = place
    allowed = _allowed_keys(sections, model)
    named = [path for path in _all_keys(model) if path.rpartition(".")[2] == name]
    alike = get_close_matches(str(name), allowed, n=1, cutoff=0.4)
    near = alike or named if sections else named or alike
    hint = f"did you mean {near[0]}? " if near else ""
    return f"{hint}allowed: {', '.join(allowed)}"


def _all_keys(model: type[BaseModel]) -> list[str]:
    """Return the keys of a model and of the sections in it: `removal.max_percent`."""
    keys = []
    for name in model.model_fields:
        inner = _section([name], model)
        keys += [f"{name}.{key}" for key in _all_keys(inner)] if inner else [name]
    return keys


def _without_kinds(place: Sequence[int | str], model: type[BaseModel]) -> tuple[int | str, ...]:
    """Return a place without what is neither a key nor the number of an item."""
    kept: list[int | str] = []
    for part in place:
        if isinstance(part, int) or part in _allowed_keys(kept, model):
            kept.append(part)
    return tuple(kept)


def _allowed_keys(sections: Sequence[int | str], model: type[BaseModel]) -> list[str]:
    section = _section(sections, model)
    return list(section.model_fields) if section else []


def _section(sections: Sequence[int | str], model: type[BaseModel]) -> type[BaseModel] | None:
    """Return the model of a section within another's; None where there is none."""
    for section in sections:
        if isinstance(section, int):  # of a list, whose model is known
            continue
        if section not in model.model_fields:
            return None
        inner = model.model_fields[section].annotation
        candidates = [inner, *get_args(inner)]
        models = [
            each for each in candidates if isinstance(each, type) and issubclass(each, BaseModel)
        ]
        if not models:
            return None
        model = models[0]
    return model
