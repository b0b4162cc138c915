"""What nights know of each other: one small file, replaced as a whole by every change."""

from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ValidationError

from dynahull.parameters import validation_message
from pipeline.errors import NightlyError
from tiling.output_file import atomic_file

JOURNAL_FILE = "journal.json"

FileState = tuple[str, int, int, int, int]
"""Name, bytes, times of the last change of content and of inode (ns), and number of the inode."""

Fingerprint = tuple[FileState, ...]
"""States of a map's files, in their order: where it is the same, so is the content."""


class Attempt(BaseModel, extra="forbid"):
    """A run that was begun and of whose end the journal does not know."""

    run: str
    """Name of its folder."""
    tasks: int
    """Tasks that earlier nights had done for it."""


class Failure(BaseModel, extra="forbid"):
    """In how many nights a map failed, and the last reason, in one line."""

    key: str
    """What failed: `Candidate.key`."""
    version: str
    """Of the product."""
    attempts: int
    reason: str


class MapRecord(BaseModel):  # what earlier versions noted beside is passed over
    """What is known of one map; results are not recorded, since they are there to be seen."""

    first_seen: float
    """Seconds since 1970."""
    fingerprint: Fingerprint = ()
    """Of the files when their content was hashed."""
    content: str | None = None
    """SHA-256 of their bytes; None where no later look may rely on it."""
    poses: str = ""
    """SHA-256 of the files of their poses; empty where there are none."""
    attempt: Attempt | None = None
    failure: Failure | None = None
    stalled: bool = False
    """Whether the last attempt was cut off without a step further: others go first then."""
    vanished: bool = False
    """Whether the files were gone when last looked for."""


class _Stored(BaseModel, extra="forbid"):
    format: Literal[1] = 1
    maps: dict[str, MapRecord] = {}


class Journal:
    """`maps`: the records of all maps ever seen, by absolute path, to be changed and saved.

    A journal that cannot be read is a `NightlyError`; without one, results are found all the same.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / JOURNAL_FILE
        try:
            self.maps = _Stored.model_validate_json(self._path.read_bytes()).maps
        except FileNotFoundError:
            self.maps = {}
        except ValidationError as error:
            raise NightlyError(
                f"{self._path}: expected a journal of this version, found "
                f"{validation_message(error, _Stored):.200}; without the file, finished results "
                "are found all the same"
            ) from None

    def save(self) -> None:
        """Replace the journal on the disk."""
        with atomic_file(self._path) as temporary:
            temporary.write_text(_Stored(maps=self.maps).model_dump_json(), encoding="utf-8")
