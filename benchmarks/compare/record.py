"""The figures on disk: written after each method, so that a comparison that was cut off goes on."""

import json
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path

from benchmarks.compare.results import Result
from tiling.output_file import atomic_file

__all__ = ["Record"]


class Record:
    """All results of a comparison, and those of an earlier one with the same data and settings.

    Parameters
    ----------
    path : Path, optional
        JSON, replaced as a whole after each result; without it nothing is kept.
    earlier : iterable of Result
        That need not be done again.
    """

    def __init__(self, path: Path | None = None, earlier: Iterable[Result] = ()) -> None:
        self._path = path
        self._results = {each.key: each for each in earlier}

    @classmethod
    def resume(cls, path: Path) -> "Record":
        """Go on with the results in a file; without the file, begin.

        Raises
        ------
        ValueError
            When the file holds something else.
        """
        if not path.exists():
            return cls(path)
        try:
            results = [Result(**each) for each in json.loads(path.read_text(encoding="utf-8"))]
        except (TypeError, ValueError) as error:
            raise ValueError(f"{path}: expected results of a comparison, found {error}") from None
        return cls(path, results)

    def finished(self, key: str) -> Result | None:
        """Return what is known already: figures, or that a method took all it was given."""
        result = self._results.get(key)
        return result if result and (result.skipped is None or result.exhausted) else None

    def add(self, result: Result) -> None:
        """Keep a result, on disk too."""
        self._results[result.key] = result
        if self._path is not None:
            told = [asdict(each) for each in self._results.values()]
            with atomic_file(self._path) as temporary:
                text = json.dumps(told, indent=2, ensure_ascii=False)
                temporary.write_text(text + "\n", encoding="utf-8")
