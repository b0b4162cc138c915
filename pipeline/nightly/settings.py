"""What is cleaned every night, and how: one YAML file, as strict as the configuration of a run."""

import glob
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, BeforeValidator, Field

from pipeline.configuration.quantities import Seconds, Size, in_home
from pipeline.configuration.run import (
    Configuration,
    load_configuration,
    load_parameters,
    ready_configurations,
)
from pipeline.errors import ConfigurationError
from pipeline.showing import is_text, printable


def _time_of_day(value: object) -> object:
    """Take 22:30, which YAML reads as 1350 where it is not quoted, for what it says."""
    if isinstance(value, int) and not isinstance(value, bool):
        return f"{value // 60:02d}:{value % 60:02d}"
    return value


TimeOfDay = Annotated[
    str, BeforeValidator(_time_of_day), Field(pattern=r"^([01]?[0-9]|2[0-3]):[0-5][0-9]$")
]
"""Hours and minutes, local time."""


class NightlyInput(BaseModel, extra="forbid", frozen=True):
    """Where maps arrive, and how those are cleaned."""

    maps: str = Field(
        min_length=1,
        description="A folder, whose own maps are meant, or a pattern: `*`, `?`, `[...]`, and `**` "
        "for folders at any depth.",
    )
    each: Literal["file", "folder"] = Field(
        "file",
        description="What a map is. `file`: every file. `folder`: the map files of a folder "
        "together; `maps` then names folders, or the folder that they are in.",
    )
    configuration: str | None = Field(
        None, description="A configuration file, or the name of a ready one; null: the defaults."
    )
    settings: tuple[str, ...] = Field(
        (), description="Single settings, such as neighbours.k=50, as `--set` of a run takes them."
    )

    @property
    def root(self) -> Path:
        """The folder that must be there: what comes before the first wildcard."""
        path = Path(self.maps)
        if os.path.exists(path):  # noqa: PTH110 (where it cannot be asked, a Path raises)
            return path
        fixed = [part for part in (path, *path.parents) if not glob.has_magic(str(part))]
        # A pattern starts in this folder; a name without a wildcard is itself what must be there.
        return fixed[0]


class Retention(BaseModel, extra="forbid", frozen=True):
    """Which results of earlier contents of a map are kept; the last good one always is."""

    runs: int = Field(3, ge=1, strict=True, description="So many runs of each map, the last ones.")
    days: Annotated[int, Field(ge=0, strict=True)] | None = Field(
        30, description="And all that are not older; null: none for their age."
    )


class NightlySettings(BaseModel, extra="forbid", frozen=True):
    """Everything that `dynahull-pipeline nightly` can be told. Paths are relative to its file."""

    inputs: tuple[NightlyInput, ...] = Field(
        min_length=1, description="Where maps arrive; a map that several name is the first one's."
    )
    output: Path = Field(description="Folder of the results, of the summary and of the journal.")
    settle: Seconds = Field(
        600, description="A map is complete when none of its files changed for so long."
    )
    wait: Seconds | None = Field(
        1800,
        description="How long a night waits, when all else is done, for maps that are still being "
        "written; null: not at all. What is not complete then is the next night's.",
    )
    attempts: int = Field(
        3,
        ge=1,
        strict=True,
        description="Nights that a map may fail before it is set aside, until its content, its "
        "configuration or the version of the product changes.",
    )
    stop_after: Seconds | None = Field(
        None, description="Length of a night; what is not done then goes on in the next one."
    )
    keep_free: Size = Field(
        0, description="Space on the disk that is left to others; a map that needs it waits."
    )
    keep: Retention = Retention()
    at: TimeOfDay = Field("02:00", description="When the night begins; for `--schedule` only.")

    def configuration_of(self, given: NightlyInput) -> Configuration:
        """Return how the maps of an input are cleaned."""
        configuration = load_configuration(given.configuration, given.settings)
        keep_free = max(self.keep_free, configuration.output.keep_free)
        output = configuration.output.model_copy(update={"keep_free": keep_free})
        return configuration.model_copy(update={"output": output})


def load_nightly_settings(source: Path, settings: Sequence[str] = ()) -> NightlySettings:
    """Read what is cleaned every night, with every path made absolute; `--set` may change it.

    Raises
    ------
    ConfigurationError
        In one line: where, what was found, and what is allowed; for the configurations of the
        inputs too, so that no night fails for them.
    """
    if not source.is_file():
        raise ConfigurationError(f"{source}: expected a YAML file, found no such file")
    given = load_parameters(NightlySettings, str(source), settings)
    folder = source.absolute().parent
    if not is_text(folder):
        raise ConfigurationError(
            f"{printable(folder)}: expected a folder whose name is UTF-8, as journals and pages are"
        )
    inputs = [
        each.model_copy(
            update={
                "maps": _pattern(folder, each.maps),
                "configuration": _place(folder, each.configuration),
            }
        )
        for each in given.inputs
    ]
    output = folder / in_home(given.output)
    found = given.model_copy(update={"inputs": tuple(inputs), "output": output})
    for each in found.inputs:
        found.configuration_of(each)
    return found


def _place(folder: Path, configuration: str | None) -> str | None:
    if configuration is None or configuration in ready_configurations():
        return configuration
    return str(folder / in_home(configuration))


def _pattern(folder: Path, maps: str) -> str:
    maps = str(in_home(maps))
    beside = glob.escape(str(folder)) if glob.has_magic(maps) else str(folder)
    return str(Path(beside) / maps)
