"""A sum of decision trees, read from a plain data file and evaluated by compiled code."""

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from dynahull.compilation import compiled, inlined
from dynahull.errors import InvalidParametersError
from dynahull.threads import over_ranges, range_bounds

_SMALLEST_RANGE = 20_000
"""Points."""


@dataclass(frozen=True, slots=True)
class Forest:
    """Trees whose leaves add up to the logarithm of the odds that a point moved.

    Attributes
    ----------
    terms : tuple of str
        What is known of a point, in the order of the columns that the trees ask for.
    baseline : float
        What is added to the sum of the leaves.
    roots : (trees,) int32 array
        The first node of each tree.
    term, left, right : (nodes,) int32 arrays
        A node asks for a term and goes left or right; at a leaf the term is -1.
    missing_left : (nodes,) bool array
        Where a term that is NaN goes.
    value : (nodes,) float64 array
        What is no larger goes left; of a leaf, what it adds.
    mean : (nodes,) float64 array
        Of the leaves below a node, over the points that it was learnt from.
    """

    terms: tuple[str, ...]
    baseline: float
    roots: npt.NDArray[np.int32]
    term: npt.NDArray[np.int32]
    left: npt.NDArray[np.int32]
    right: npt.NDArray[np.int32]
    missing_left: npt.NDArray[np.bool_]
    value: npt.NDArray[np.float64]
    mean: npt.NDArray[np.float64]

    @classmethod
    def of(cls, stored: dict[str, Any]) -> Self:
        """Build from what `stored` gives, checking that no node leads out of the trees.

        Raises
        ------
        InvalidParametersError
            When the trees are not whole.
        """
        try:
            trees = stored["trees"]
            nodes = [node for tree in trees for node in tree]
            starts = np.cumsum([0, *(len(tree) for tree in trees)])
            own = np.repeat(starts[:-1], [len(tree) for tree in trees])
            leaf = np.array([len(node) == 1 for node in nodes])
            names = {name: number for number, name in enumerate(stored["terms"])}
            term = np.array([-1 if len(node) == 1 else names[node[0]] for node in nodes], np.int32)
            value = np.array([node[0] if len(node) == 1 else node[1] for node in nodes])
            mean = np.array([node[0] if len(node) == 1 else node[4] for node in nodes])
            # A node's left branch comes next; where its right one comes is written down.
            right = np.array([0 if len(node) == 1 else node[2] for node in nodes]) + own
            missing = np.array([len(node) > 1 and node[3] == "left" for node in nodes])
            place = np.arange(len(nodes))
            left = np.where(leaf, place, place + 1)
            right = np.where(leaf, place, right)
            end = np.repeat(starts[1:], [len(tree) for tree in trees])
            if not ((left < end) & (right < end) & (leaf | (right > place))).all():
                raise ValueError("a branch that leads out of its tree")
            return cls(
                tuple(stored["terms"]),
                float(stored["baseline"]),
                starts[:-1].astype(np.int32),
                term,
                left.astype(np.int32),
                right.astype(np.int32),
                missing,
                value.astype(np.float64),
                mean.astype(np.float64),
            )
        except (KeyError, IndexError, TypeError, ValueError) as error:
            raise InvalidParametersError(f"trees: expected whole ones, found {error!r}") from None

    def log_odds(
        self, evidence: npt.NDArray[np.float32], threads: int = 1
    ) -> npt.NDArray[np.float32]:
        """Return the logarithm of the odds of each point, (n,).

        Parameters
        ----------
        evidence : (n, len(terms)) float32 array
        threads : int
            They change nothing about the result.
        """
        found = np.empty(len(evidence), np.float32)
        over_ranges(
            lambda first, end: _add_up(
                evidence, self.roots, self.term, self.left, self.right, self.missing_left,
                self.value, self.baseline, first, end, found,
            ),
            range_bounds(len(evidence), threads, _SMALLEST_RANGE),
            threads,
        )  # fmt: skip
        return found

    def contributions(
        self, evidence: npt.NDArray[np.float32], groups: npt.NDArray[np.int32], count: int
    ) -> npt.NDArray[np.float32]:
        """Return what each group of terms adds to the logarithm of the odds, (n, count).

        Parameters
        ----------
        evidence : (n, len(terms)) float32 array
        groups : (len(terms),) int32 array
            The group of each term, below `count`.
        count : int
        """
        found = np.zeros((len(evidence), count), np.float32)
        _add_changes(
            evidence, self.roots, self.term, self.left, self.right, self.missing_left,
            self.value, self.mean, groups, found,
        )  # fmt: skip
        return found


@inlined
def _child(
    known: float,
    node: int,
    left: npt.NDArray[np.int32],
    right: npt.NDArray[np.int32],
    missing_left: npt.NDArray[np.bool_],
    value: npt.NDArray[np.float64],
) -> int:
    """Return where a node sends what is known of a point."""
    goes_left = missing_left[node] if np.isnan(known) else known <= value[node]
    return int(left[node] if goes_left else right[node])


@compiled
def _add_up(
    evidence: npt.NDArray[np.float32],
    roots: npt.NDArray[np.int32],
    term: npt.NDArray[np.int32],
    left: npt.NDArray[np.int32],
    right: npt.NDArray[np.int32],
    missing_left: npt.NDArray[np.bool_],
    value: npt.NDArray[np.float64],
    baseline: float,
    first: int,
    end: int,
    found: npt.NDArray[np.float32],
) -> None:
    for point in range(first, end):
        total = baseline
        for root in roots:
            node = root
            while term[node] >= 0:
                known = evidence[point, term[node]]
                node = _child(known, node, left, right, missing_left, value)
            total += value[node]
        found[point] = total


@compiled
def _add_changes(
    evidence: npt.NDArray[np.float32],
    roots: npt.NDArray[np.int32],
    term: npt.NDArray[np.int32],
    left: npt.NDArray[np.int32],
    right: npt.NDArray[np.int32],
    missing_left: npt.NDArray[np.bool_],
    value: npt.NDArray[np.float64],
    mean: npt.NDArray[np.float64],
    groups: npt.NDArray[np.int32],
    found: npt.NDArray[np.float32],
) -> None:
    for point in range(len(evidence)):
        for root in roots:
            node = root
            while term[node] >= 0:
                known = evidence[point, term[node]]
                child = _child(known, node, left, right, missing_left, value)
                found[point, groups[term[node]]] += mean[child] - mean[node]
                node = child
