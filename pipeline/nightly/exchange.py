"""What the night and the process that cleans a map tell each other."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

from pipeline.configuration import Configuration


@dataclass(frozen=True, slots=True)
class Request:
    """What to clean.

    Attributes
    ----------
    map : Path
        A file, or the folder of a map of several.
    output : Path
        Folder of the run.
    configuration : Configuration
    root : Path or None
        The folder that the map lies in, and no link leads out of.
    """

    map: Path
    output: Path
    configuration: Configuration
    root: Path | None = None

    def to_text(self) -> str:
        """Return the request as text of one line."""
        values = {
            "map": str(self.map),
            "output": str(self.output),
            "root": None if self.root is None else str(self.root),
            "configuration": self.configuration.model_dump(mode="json"),
        }
        return json.dumps(values)

    @classmethod
    def from_text(cls, text: str) -> "Request":
        """Read the text."""
        values = json.loads(text)
        configuration = Configuration.model_validate(values["configuration"])
        root = None if values["root"] is None else Path(values["root"])
        return cls(Path(values["map"]), Path(values["output"]), configuration, root)


@dataclass(frozen=True, slots=True)
class Ended:
    """How a run ended.

    Attributes
    ----------
    how : str
        `stopped`: as it was asked to. `died`: without a word.
    reason : str
        Of a failure, in one line.
    """

    how: Literal["cleaned", "failed", "no space", "stopped", "died"]
    reason: str = ""

    def to_text(self) -> str:
        """Return it as text of one line."""
        return json.dumps(asdict(self))

    @classmethod
    def from_text(cls, text: str) -> "Ended":
        """Read the text."""
        values = json.loads(text)
        return cls(values["how"], values["reason"])
