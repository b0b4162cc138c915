"""One night: what is new or changed is cleaned, one map after the other, until all is done or over.

A map's state follows from what is on the disk: its files, its results, and the journal of what was
tried. So a night may be killed at any moment, and the next one goes on.
"""

import logging
from collections.abc import Iterable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

from pipeline.errors import DiskSpaceError, NightLockedError
from pipeline.nightly.clock import Clock, NightEnd
from pipeline.nightly.inventory import (
    Candidate,
    Problem,
    failures,
    find_maps,
    in_turn,
    last_change,
    learn_content,
    verdict,
)
from pipeline.nightly.journal import Attempt, Failure, Fingerprint, Journal, MapRecord
from pipeline.nightly.minutes import (
    INDEX_FILE,
    MapOutcome,
    Minutes,
    NightSummary,
    refuse_to_replace,
    write_index,
)
from pipeline.nightly.one_map import Cleaner, Ended, Request
from pipeline.nightly.results import (
    MapFolder,
    is_finished,
    map_name,
    remove_finished_work,
    remove_old_runs,
    run_report,
    tasks_done,
)
from pipeline.nightly.settings import NightlySettings
from pipeline.outputs.folder_lock import folder_is_locked, locked_folder
from pipeline.plan.resources import check_space
from pipeline.showing import only_showing, printable
from tiling.output_file import writing_only_into

STATE_FOLDER = ".nightly"
"""Within the output folder: lock and journal."""

_LONGEST_SLEEP = 30.0
"""Seconds between two looks at maps that are being written."""

logger = logging.getLogger("dynahull")


def clean_nightly(
    settings: NightlySettings, cleaner: Cleaner, clock: Clock, end: NightEnd, *, retry: bool = False
) -> NightSummary:
    """Spend one night; return what `nightly.json` holds.

    Parameters
    ----------
    retry : bool
        Forget all failures: what was set aside is tried again.

    Raises
    ------
    NightLockedError
        When another night works on the output folder.
    NightlyError
        When the journal cannot be read.
    """
    state = settings.output / STATE_FOLDER
    state.mkdir(parents=True, exist_ok=True)
    with locked_folder(state, "night", NightLockedError), writing_only_into(settings.output):
        refuse_to_replace(settings.output)
        night = _Night(settings, cleaner, clock, end, Journal(state))
        if retry:
            night.forget_failures()
        night.take_up_what_was_cut_off()
        while not end.is_over():
            candidates = night.look()
            ready = night.ready(candidates)
            for candidate in ready:
                if end.is_over():
                    break
                night.clean(candidate)
            if not ready and not night.wait_for_writers(candidates):
                break
        candidates = night.look()
        night.remove_what_is_old(candidates)
        return night.close(candidates)


@dataclass
class _Night:
    """What the steps of a night share."""

    settings: NightlySettings
    cleaner: Cleaner
    clock: Clock
    end: NightEnd
    journal: Journal

    def __post_init__(self) -> None:
        inputs = self.settings.inputs
        self.configurations = [self.settings.configuration_of(each) for each in inputs]
        self.minutes = Minutes(self.settings.output, self.clock)
        self.problems: list[Problem] = []
        self.tried: set[tuple[Path, Fingerprint]] = set()
        self.runs_begun = 0
        self.waited = 0.0

    def forget_failures(self) -> None:
        for record in self.journal.maps.values():
            record.failure = None
        self.journal.save()

    def take_up_what_was_cut_off(self) -> None:
        """Find out what became of maps that a night was killed over."""
        for path, record in self.journal.maps.items():
            folder = self.folder_of(Path(path))
            folder.remove_leftovers()
            if record.attempt is None:
                continue
            run = folder.path / record.attempt.run
            if run.is_dir() and folder_is_locked(run):
                continue
            if is_of_content(run, record):
                remove_finished_work(run)
                folder.point_latest(run)
                self.minutes.cleaned_earlier(Path(path), run)
            else:
                record.stalled = tasks_done(run) <= record.attempt.tasks
                logger.info("%s: an earlier night was cut off; it goes on", printable(path))
            record.attempt = None
        self.journal.save()

    def look(self) -> list[Candidate]:
        """Look at what maps there are now, and note which are gone."""
        found, self.problems = find_maps(self.settings, self.configurations)
        self.minutes.problems([problem.message for problem in self.problems])
        candidates = []
        for each in found:
            if (place := self.folder_of(each.path).path).is_symlink():
                self.minutes.problems([f"{place}: expected a folder of results, found a link"])
                continue
            try:
                states = each.states()
            except FileNotFoundError:
                continue
            except OSError as error:
                self.minutes.problems([f"{error.filename}: {error.strerror}"])
                continue
            new = MapRecord(first_seen=self.clock.now())
            record = self.journal.maps.setdefault(str(each.path), new)
            record.vanished = False
            candidates.append(Candidate(each, states, record, MapFolder(place)))
        self.note_vanished({str(each.path) for each in found})
        self.journal.save()
        return candidates

    def note_vanished(self, there: set[str]) -> None:
        """Note what is gone, except where a whole input is."""
        missing = [problem.root for problem in self.problems]
        for path, record in self.journal.maps.items():
            unseen = any(root in (Path(path), *Path(path).parents) for root in missing)
            if path not in there and not record.vanished and not unseen:
                record.vanished = True
                self.minutes.say(Path(path), MapOutcome.VANISHED, self.folder_of(Path(path)))

    def ready(self, candidates: Iterable[Candidate]) -> list[Candidate]:
        waiting = [
            each
            for each in candidates
            if self.verdict(each) is None and (each.found.path, each.states) not in self.tried
        ]
        return in_turn(waiting)

    def verdict(self, candidate: Candidate) -> MapOutcome | None:
        """Return why a map is not to be cleaned, None if it is."""
        return verdict(candidate, self.settings, self.clock.now())

    def clean(self, candidate: Candidate) -> None:
        """Clean a map, if its content is really new, and put down what became of it."""
        if not candidate.is_as_seen():
            return  # written anew, or gone, while others were cleaned: the next look tells which
        begun = self.clock.monotonic()
        outcome, reason = self.try_to_clean(candidate)
        if outcome is None:
            return
        self.tried.add((candidate.found.path, candidate.states))
        record = candidate.record
        self.minutes.say(
            candidate.found.path,
            outcome,
            candidate.folder,
            reason=reason,
            attempts=record.failure.attempts if record.failure else 0,
            seconds=round(self.clock.monotonic() - begun, 1),
        )
        # Last: until then the journal on the disk knows of an attempt, of which a night that
        # follows a kill says what was not said.
        self.journal.save()

    def try_to_clean(self, candidate: Candidate) -> tuple[MapOutcome | None, str | None]:
        """Return what became of a map, and why; None where the end of the night came first."""
        try:
            known = candidate.content is not None or learn_content(
                candidate, self.clock.now, self.stop_hashing
            )
        except _NightOverError:
            return None, None
        except OSError as error:
            place = error.filename or candidate.found.path
            return self.failed(candidate, f"{place}: {error.strerror}")
        if not known:
            return MapOutcome.WAITING, "it changed while it was read"
        settled = self.verdict(candidate)
        if settled is not None:
            if result := candidate.folder.result(candidate.key):
                candidate.folder.point_latest(result)
            return settled, None
        try:
            size = sum(state[1] for state in candidate.states)
            check_space(self.settings.output, 0, size, self.settings.keep_free)
        except DiskSpaceError as error:
            return MapOutcome.NO_SPACE, str(error)
        return self.run(candidate)

    def stop_hashing(self, _: int) -> None:
        if self.end.is_over():
            raise _NightOverError

    def run(self, candidate: Candidate) -> tuple[MapOutcome, str | None]:
        """Run a map, with the journal knowing before and after."""
        folder, record, found = candidate.folder, candidate.record, candidate.found
        run = folder.of_key(candidate.key) or folder.new(candidate.key, self.clock.now())
        if run.is_dir() and folder_is_locked(run):
            return MapOutcome.LEFT, "what a killed night left is still at work on it"
        for other in folder.runs():
            if other != run and not is_finished(other):
                folder.remove(other)
        earlier = tasks_done(run)
        record.attempt = Attempt(run=run.name, tasks=earlier)
        self.journal.save()
        is_first = self.runs_begun == 0
        self.runs_begun += 1
        logger.info("%s: cleaning into %s", printable(found.path), run)
        level = logger.getEffectiveLevel()
        request = Request(found.path, run, found.configuration, found.root, level)
        ended = self.cleaner.clean(request, self.end.is_over)
        record.attempt = None
        record.stalled = False
        if ended.how == "cleaned":
            return self.publish(candidate, run)
        return self.put_down(candidate, ended, tasks_done(run) > earlier, is_first)

    def put_down(
        self, candidate: Candidate, ended: Ended, advanced: bool, had_whole_night: bool
    ) -> tuple[MapOutcome, str | None]:
        """Judge a run that came to no result."""
        if not candidate.is_as_seen():
            return MapOutcome.WAITING, "it changed while it was cleaned"
        if ended.how == "no space":
            return MapOutcome.NO_SPACE, ended.reason
        if ended.how != "stopped":
            return self.failed(candidate, ended.reason)
        if had_whole_night and not advanced and self.end.reason() == "time":
            return self.failed(candidate, "it came no step further in a whole night")
        candidate.record.stalled = not advanced
        return MapOutcome.STOPPED, None

    def publish(self, candidate: Candidate, run: Path) -> tuple[MapOutcome, str | None]:
        """Let `latest` point to a result, if it is that of the content it was made for."""
        if not is_of_content(run, candidate.record):
            # The map was replaced before the run began to read it.
            candidate.folder.remove(run)
            return MapOutcome.WAITING, "it changed before it was read"
        candidate.folder.point_latest(run)
        candidate.record.failure = None
        return MapOutcome.CLEANED, None

    def failed(self, candidate: Candidate, reason: str) -> tuple[MapOutcome, str]:
        """Count a failure; with the last one allowed the map is set aside."""
        key, product = candidate.key, version("dynahull-pipeline")
        attempts = failures(candidate) + 1
        candidate.record.failure = Failure(
            key=key, version=product, attempts=attempts, reason=reason
        )
        if attempts >= self.settings.attempts:
            reason += f"; set aside after {attempts} nights, until it changes"
        return MapOutcome.FAILED, reason

    def wait_for_writers(self, candidates: Iterable[Candidate]) -> bool:
        """Let time pass while maps are being written, where there is any; tell whether it did."""
        now = self.clock.now()
        open_ones = [each for each in candidates if self.verdict(each) is MapOutcome.WAITING]
        left = (self.settings.wait or 0) - self.waited
        if not open_ones or left <= 0:
            return False
        first = min(last_change(each.states, now) for each in open_ones) + self.settings.settle
        seconds = min(max(first - now, 1.0), _LONGEST_SLEEP, left)
        if not self.waited:
            logger.info("waiting for %d maps that are still being written", len(open_ones))
        self.end.sleep(seconds)
        self.waited += seconds
        return True

    def remove_what_is_old(self, candidates: Iterable[Candidate]) -> None:
        """Remove results of earlier contents, and work that nobody will finish."""
        known = {str(each.found.path): each for each in candidates if each.content is not None}
        for path, record in list(self.journal.maps.items()):
            candidate, folder = known.get(path), self.folder_of(Path(path))
            wanted = None
            if candidate and self.verdict(candidate) is not MapOutcome.SET_ASIDE:
                wanted = candidate.key
            # Of a map that is not there, or not read, nobody knows what it will be.
            work_may_go_on = candidate is None
            now, keep = self.clock.now(), self.settings.keep
            remove_old_runs(folder, keep, now, wanted, work_may_go_on=work_may_go_on)
            if record.vanished and not folder.runs():
                del self.journal.maps[path]
        self.journal.save()

    def close(self, candidates: Iterable[Candidate]) -> NightSummary:
        """Say what became of every map that nothing was said of yet, and write the summary."""
        for each in candidates:
            outcome = self.verdict(each) or MapOutcome.LEFT
            if outcome is MapOutcome.UNCHANGED and (result := each.folder.result(each.key)):
                each.folder.point_latest(result)
            self.minutes.say_once(each.found.path, outcome, each.folder, each.record.failure)
        for path, record in self.journal.maps.items():
            if record.vanished:
                self.minutes.mention(Path(path), MapOutcome.VANISHED, self.folder_of(Path(path)))
        summary = self.minutes.close(self.end.reason())
        with only_showing(INDEX_FILE, logger.warning):
            write_index(self.settings.output, summary)
        return summary

    def folder_of(self, path: Path) -> MapFolder:
        return MapFolder(self.settings.output / map_name(path))


def is_of_content(run: Path, record: MapRecord) -> bool:
    """Tell whether a run is whole, and of the content that the journal knows."""
    return record.content is not None and run_report(run).get("input_hash") == record.content


class _NightOverError(Exception):
    """The night ended while a map was hashed."""
