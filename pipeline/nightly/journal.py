"""What nights know of each other: one small file, replaced as a whole by every change."""

from pathlib import Path

from pydantic import BaseModel, Field, ValidationError

from dynahull.parameters import validation_message
from pipeline.errors import NightlyError
from tiling.atomic import atomic_file

JOURNAL_FILE = "journal.json"

_FORMAT = 1

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
    """Why a map failed, and how often."""

    key: str
    """What failed: hash of content and configuration, or of the states of files that cannot be
    read."""
    version: str
    """Of the product."""
    attempts: int
    """Nights that it failed."""
    reason: str
    """The last one, in one line."""


class MapRecord(BaseModel, extra="forbid"):
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
    seen: Fingerprint = ()
    """Of files whose dates are in the future: as they were when last looked at."""
    seen_since: float = 0.0
    """Since when they have been so, seconds since 1970."""


class _Stored(BaseModel, extra="forbid"):
    format: int = Field(_FORMAT, ge=_FORMAT, le=_FORMAT)
    maps: dict[str, MapRecord] = {}


class Journal:
    """The records of all maps ever seen, by absolute path.

    Raises
    ------
    NightlyError
        When there is a journal that cannot be read. Without one, finished results are found all
        the same.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / JOURNAL_FILE
        try:
            self._stored = _Stored.model_validate_json(self._path.read_bytes())
        except FileNotFoundError:
            self._stored = _Stored()
        except ValidationError as error:
            raise NightlyError(
                f"{self._path}: expected a journal of this version, found "
                f"{validation_message(error, _Stored):.200}; without the file, finished results "
                "are found all the same"
            ) from None

    @property
    def maps(self) -> dict[str, MapRecord]:
        """The records, to be changed in place and saved."""
        return self._stored.maps

    def record(self, path: Path, now: float) -> MapRecord:
        """Return the record of a map, a new one where there is none."""
        return self.maps.setdefault(str(path), MapRecord(first_seen=now))

    def save(self) -> None:
        """Replace the journal on the disk."""
        with atomic_file(self._path) as temporary:
            temporary.write_text(self._stored.model_dump_json(), encoding="utf-8")
