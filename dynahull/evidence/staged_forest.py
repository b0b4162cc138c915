"""Trees that are asked in stages, and others in their place among dense surroundings."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from dynahull.errors import InvalidParametersError
from dynahull.evidence.forest import Forest

_Rows = slice | npt.NDArray[np.intp]


class Above(NamedTuple):
    """Points of which a term is above a limit, and the trees that judge them alone."""

    column: int
    limit: float
    forest: Forest


class Likely(NamedTuple):
    """Points of whose odds all stages before make more than a limit, and the trees that decide."""

    limit: float
    forest: Forest


@dataclass(frozen=True, slots=True)
class StagedForest:
    """Trees most of which are asked about doubtful points only (Viola and Jones, CVPR 2001).

    Attributes
    ----------
    quick : Forest
        Asked about all points but those of `dense`.
    rest : Forest
        Asked about points of whose odds the quick ones make more than `doubtful`.
    doubtful : float
        A logarithm of odds.
    likely : Likely, optional
        More trees, that judge likely points alone: the others only had to find these.
    dense : Above, optional
        Trees for places that were seen thousands of times: what is thin there is a ghost more
        surely than elsewhere.
    """

    quick: Forest
    rest: Forest
    doubtful: float
    likely: Likely | None = None
    dense: Above | None = None

    @classmethod
    def of(cls, stored: dict[str, Any]) -> Self:
        """Build as `Forest.of` does; `quick` says how many of the trees come first.

        `likely`, where it is there, has trees of its own, and the limit `above` which they decide.
        `dense`, where it is there, has trees of its own, and the `term` and the limit `above`
        which they are asked.

        Raises
        ------
        InvalidParametersError
            When the trees are not whole.
        """
        try:
            trees, quick, doubtful = stored["trees"], int(stored["quick"]), stored["doubtful"]
            doubtful = float(np.float32(doubtful))  # what is compared with it are float32
            likely, dense = stored.get("likely"), stored.get("dense")
            likely = likely and Likely(float(np.float32(likely["above"])), Forest.of(likely))
            dense = dense and _above(dense)
        except (KeyError, TypeError, ValueError) as error:
            raise InvalidParametersError(f"trees: expected stages, found {error!r}") from None
        first = Forest.of(stored | {"trees": trees[:quick]})
        others = [each.forest for each in (likely, dense) if each is not None]
        if any(forest.terms != first.terms for forest in others):
            raise InvalidParametersError("trees: expected the same terms of all, found others")
        rest = Forest.of(stored | {"trees": trees[quick:], "baseline": 0.0})
        return cls(first, rest, doubtful, likely, dense)

    @property
    def terms(self) -> tuple[str, ...]:
        """What is known of a point."""
        return self.quick.terms

    def log_odds(
        self, evidence: npt.NDArray[np.float32], threads: int = 1
    ) -> npt.NDArray[np.float32]:
        """Return the logarithm of the odds of each point, (n,): see `Forest.log_odds`.

        A doubtful point is never less likely than one that is not, so that what holds of each
        forest as a term grows holds of both.
        """
        found = np.empty(len(evidence), np.float32)
        for rows, dense in self._groups(evidence):
            own = evidence[rows]
            found[rows] = dense.log_odds(own, threads) if dense else self._staged(own, threads)
        return found

    def contributions(
        self, evidence: npt.NDArray[np.float32], groups: npt.NDArray[np.int32], count: int
    ) -> npt.NDArray[np.float32]:
        """Return what each group of terms adds, (n, count): see `Forest.contributions`.

        The quick trees speak for all stages: the others seldom say other.
        """
        found = np.empty((len(evidence), count), np.float32)
        for rows, dense in self._groups(evidence):
            found[rows] = (dense or self.quick).contributions(evidence[rows], groups, count)
        return found

    def _groups(self, evidence: npt.NDArray[np.float32]) -> Iterator[tuple[_Rows, Forest | None]]:
        """Yield the points that the stages judge, and those that the trees of `dense` do."""
        if self.dense is None:
            yield slice(None), None
            return
        above = evidence[:, self.dense.column] > self.dense.limit
        yield (np.flatnonzero(~above) if above.any() else slice(None)), None
        if above.any():
            yield np.flatnonzero(above), self.dense.forest

    def _staged(self, evidence: npt.NDArray[np.float32], threads: int) -> npt.NDArray[np.float32]:
        found = self.quick.log_odds(evidence, threads)
        rows = np.flatnonzero(found > self.doubtful)
        both = found[rows] + self.rest.log_odds(evidence[rows], threads)
        found[rows] = np.maximum(both, np.float32(self.doubtful))
        if self.likely is not None:
            limit, forest = self.likely
            rows = np.flatnonzero(found > limit)
            found[rows] = np.maximum(forest.log_odds(evidence[rows], threads), np.float32(limit))
        return found


def _above(stored: dict[str, Any]) -> Above:
    forest = Forest.of(stored)
    return Above(forest.terms.index(stored["term"]), float(stored["above"]), forest)
