"""The configuration of a run: one YAML file, small models, unknown keys refused."""

from collections.abc import Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Literal, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic_core import ErrorDetails

from dynahull.parameters import MethodParameters
from pipeline.errors import ConfigurationError

Model = TypeVar("Model", bound=BaseModel)


class ExecutionParameters(BaseModel):
    """How the work is spread over the machine; the result does not depend on it."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    workers: int | Literal["auto"] = Field(
        "auto", description="Threads of the density step; `auto`: one for each available core."
    )


class OutputParameters(BaseModel):
    """What is written beside the cleaned map."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    labels: bool = Field(
        False, description="Write labels.parquet: label, cluster and density of every point."
    )


class Configuration(MethodParameters):
    """Everything a run can be told: the sections of the method, and those of the product."""

    execution: ExecutionParameters = ExecutionParameters()
    output: OutputParameters = OutputParameters()

    def method(self) -> MethodParameters:
        """Return the sections that `dynahull` knows."""
        return MethodParameters.model_validate(
            {name: getattr(self, name) for name in MethodParameters.model_fields}
        )

    def to_yaml(self) -> str:
        """Return the configuration as the YAML that `load_configuration` reads back."""
        return yaml.safe_dump(self.model_dump(mode="json"), sort_keys=False)


def ready_configurations() -> dict[str, Path]:
    """Return the configurations that come with the product, by name."""
    # Beside this module in an installed package, beside the package in a checkout.
    here = Path(__file__).resolve().parent
    folder = next(place for place in (here / "configs", here.parent / "configs") if place.is_dir())
    return {path.stem: path for path in sorted(folder.glob("*.yaml"))}


def load_configuration(source: str | None, settings: Sequence[str] = ()) -> Configuration:
    """Read the configuration of a run and apply single settings to it.

    Parameters
    ----------
    source : str or None
        Path of a YAML file, or the name of a ready configuration (`indoor`); None for defaults.
    settings : sequence of str
        `section.key=value`, as given to `--set`; the value is YAML. Later ones win.

    Returns
    -------
    Configuration

    Raises
    ------
    ConfigurationError
        In one line: where, what was found, and what is allowed.
    """
    return load_parameters(Configuration, source, settings)


def load_parameters(model: type[Model], source: str | None, settings: Sequence[str] = ()) -> Model:
    """Read any model as `load_configuration` reads the configuration of a run."""
    values = _read_yaml(_configuration_path(source)) if source else {}
    for setting in settings:
        _apply(setting, values)
    try:
        return model.model_validate(values)
    except ValidationError as error:
        problem = _plain(error.errors()[0], model)
        raise ConfigurationError(f"{source or 'configuration'}: {problem}") from None


def _configuration_path(source: str) -> Path:
    path = Path(source)
    ready = ready_configurations()
    if path.is_file() or source not in ready:
        return path
    return ready[source]


def _read_yaml(path: Path) -> dict[str, Any]:
    try:
        values = yaml.safe_load(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        ready = ", ".join(ready_configurations())
        raise ConfigurationError(
            f"{path}: expected a YAML file or one of the ready configurations ({ready}), "
            "found no such file"
        ) from None
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"{path}: expected a YAML file, found {error}") from None
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        place = f" at line {mark.line + 1}" if mark else ""
        problem = getattr(error, "problem", None) or "something else"
        raise ConfigurationError(f"{path}: expected YAML, found {problem}{place}") from None
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
    except yaml.YAMLError:
        raise ConfigurationError(
            f"--set {setting}: expected a YAML value, found {text!r}"
        ) from None
    *sections, name = key.split(".")
    for section in sections:
        inner = values.setdefault(section, {})
        if not isinstance(inner, dict):
            raise ConfigurationError(f"--set {setting}: {section} is a value, not a section")
        values = inner
    values[name] = value


def _plain(error: ErrorDetails, model: type[BaseModel]) -> str:
    """Say a validation error in one line, with the nearest allowed name where a key is unknown."""
    place = ".".join(str(part) for part in error["loc"])
    if error["type"] != "extra_forbidden":
        message = error["msg"].removeprefix("Value error, ")
        found = "" if isinstance(error["input"], dict) else f", found {error['input']!r}"
        return f"{place}: {message[:1].lower()}{message[1:]}{found}"
    allowed = _allowed_keys(error["loc"][:-1], model)
    near = get_close_matches(str(error["loc"][-1]), allowed, n=1, cutoff=0.4)
    hint = f"did you mean {near[0]}? " if near else ""
    return f"{place}: no such key; {hint}allowed: {', '.join(allowed)}"


def _allowed_keys(sections: Sequence[int | str], model: type[BaseModel]) -> list[str]:
    for section in sections:
        inner = model.model_fields[str(section)].annotation
        if not (isinstance(inner, type) and issubclass(inner, BaseModel)):
            return []
        model = inner
    return list(model.model_fields)
