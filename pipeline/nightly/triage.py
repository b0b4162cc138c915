"""Which maps are to be cleaned, and in which turn."""

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass, replace
from importlib.metadata import version

from pipeline.nightly.inventory import FoundMap, last_change, trusted_content
from pipeline.nightly.journal import Fingerprint, MapRecord
from pipeline.nightly.results import MapFolder, result_key, tasks_done
from pipeline.nightly.settings import NightlySettings
from pipeline.nightly.summary import MapOutcome


@dataclass(frozen=True, slots=True)
class Candidate:
    """A map that is there, and what is known of it."""

    found: FoundMap
    states: Fingerprint
    """Its files, when it was looked at."""
    record: MapRecord
    folder: MapFolder
    is_read: bool = False
    """Whether its content was read since it was looked at."""

    def of_content(self) -> "Candidate":
        """Return the map as one whose content was read just now."""
        return replace(self, is_read=True)

    def last_change(self, now: float) -> float:
        """Return when the map was last written to, seconds since 1970."""
        known = self.record.seen == self.states
        return last_change(self.states, now, self.record.seen_since if known else None)

    def is_as_seen(self) -> bool:
        """Tell whether its files still are what they were when it was looked at."""
        try:
            return self.found.states() == self.states
        except OSError:
            return False

    @property
    def content(self) -> str | None:
        """SHA-256 of its bytes, None where they must be read to know it."""
        return self.record.content if self.is_read else trusted_content(self.record, self.states)

    @property
    def key(self) -> str:
        """What a result, or a failure, is of: content and configuration, or files not read yet."""
        if self.content is None:
            return "unread-" + hashlib.sha256(repr(self.states).encode()).hexdigest()[:16]
        found, poses = self.found, self.record.poses
        return result_key(self.content, found.files, found.configuration, poses)


def verdict(candidate: Candidate, settings: NightlySettings, now: float) -> MapOutcome | None:
    """Return why a map is not to be cleaned now, None if it is."""
    if now - candidate.last_change(now) < settings.settle:
        return MapOutcome.WAITING
    if candidate.folder.result(candidate.key) is not None:
        return MapOutcome.UNCHANGED
    if failures(candidate) >= settings.attempts:
        return MapOutcome.SET_ASIDE
    return None


def failures(candidate: Candidate) -> int:
    """Count the nights that a map failed as it is, by this version of the product."""
    failure = candidate.record.failure
    if failure is None or failure.key != candidate.key:
        return 0
    return failure.attempts if failure.version == version("dynahull-pipeline") else 0


def in_turn(candidates: Iterable[Candidate]) -> list[Candidate]:
    """Put maps in the order in which they are cleaned.

    First what was stopped half done, then what was never tried, the longest known first, and last
    what failed or came no step further: so that nothing keeps the others from being done.
    """

    def turn(candidate: Candidate) -> tuple[int, int, float, str]:
        record, failed = candidate.record, failures(candidate)
        begun = candidate.folder.of_key(candidate.key)
        goes_on = begun is not None and tasks_done(begun) > 0
        rank = 2 if failed or record.stalled else 0 if goes_on else 1
        return rank, failed, record.first_seen, str(candidate.found.path)

    return sorted(candidates, key=turn)
