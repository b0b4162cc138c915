"""A sum of decision trees, read from a plain data file and evaluated by compiled code.

No tree is walked: the questions about one term are asked in the order of their limits, and each
answer strikes out the leaves that can no longer be reached. The first leaf left of a tree is the
one that a walk ends at (QuickScorer: Lucchese et al., SIGIR 2015).
"""

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from dynahull.compilation import compiled, inlined
from dynahull.errors import InvalidParametersError
from dynahull.threads import over_ranges, range_bounds

MOST_LEAVES = 64
"""Of a tree: a bit each."""

_SMALLEST_RANGE = 20_000
"""Points."""

_SEQUENCE = np.uint64(0x03F79D71B4CB0A89)
"""Of de Bruijn: each of its 64 windows of six bits is another number."""

_PLACES = np.zeros(64, np.int32)
_PLACES[[(int(_SEQUENCE) << place) % 2**64 >> 58 for place in range(64)]] = np.arange(64)


@dataclass(frozen=True, slots=True)
class Forest:
    """Trees whose leaves add up to the logarithm of the odds that a point moved.

    Attributes
    ----------
    terms : tuple of str
        What is known of a point, in the order of the columns that the trees ask for.
    baseline : float
        What is added to the sum of the leaves.
    begins : (terms + 1,) int32 array
        Where the questions about each term begin.
    limit : (questions,) float64 array
        What is no larger goes left; ascending for each term.
    tree : (questions,) int32 array
        The tree of a question.
    kept : (questions,) uint64 array
        The leaves of its tree that can still be reached by what goes right, a bit each.
    missing_left : (questions,) bool array
        Whether a term that is NaN goes left.
    first_leaf : (trees + 1,) int32 array
        Where the leaves of each tree begin, from left to right.
    value : (leaves,) float64 array
        What a leaf adds.
    changes : (leaves, terms) float64 array
        What the questions about each term, on the way to a leaf, change about what is expected.
    """

    terms: tuple[str, ...]
    baseline: float
    begins: npt.NDArray[np.int32]
    limit: npt.NDArray[np.float64]
    tree: npt.NDArray[np.int32]
    kept: npt.NDArray[np.uint64]
    missing_left: npt.NDArray[np.bool_]
    first_leaf: npt.NDArray[np.int32]
    value: npt.NDArray[np.float64]
    changes: npt.NDArray[np.float64]

    @classmethod
    def of(cls, stored: dict[str, Any]) -> Self:
        """Build from a baseline and trees, each the list of its nodes, depth first.

        A node is [value] of a leaf, or [term, limit, place of the right branch, missing, mean]:
        its left branch comes next, missing says where NaN goes, mean is that of its leaves.

        Raises
        ------
        InvalidParametersError
            When the trees are not whole, or one has more leaves than `MOST_LEAVES`.
        """
        try:
            names = tuple(stored["terms"])
            trees = [_Tree(nodes, names) for nodes in stored["trees"]]
            asked = np.array(
                [
                    (question.term, question.limit, number, question.missing_left)
                    for number, tree in enumerate(trees)
                    for question in tree.questions
                ],
                dtype=[("term", "i4"), ("limit", "f8"), ("tree", "i4"), ("missing_left", "?")],
            )
            kept = np.array([each.kept for tree in trees for each in tree.questions], np.uint64)
            order = np.argsort(asked, order=("term", "limit", "tree"), kind="stable")
            asked, kept = asked[order], kept[order]
            return cls(
                names,
                float(stored["baseline"]),
                np.searchsorted(asked["term"], np.arange(len(names) + 1)).astype(np.int32),
                np.ascontiguousarray(asked["limit"]),
                np.ascontiguousarray(asked["tree"]),
                kept,
                np.ascontiguousarray(asked["missing_left"]),
                np.cumsum([0, *(len(tree.values) for tree in trees)]).astype(np.int32),
                np.array([value for tree in trees for value in tree.values], np.float64),
                np.array([each for tree in trees for each in tree.changes], np.float64),
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
                evidence, self.begins, self.limit, self.tree, self.kept, self.missing_left,
                self.first_leaf, self.value, self.baseline, first, end, found,
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
            evidence, self.begins, self.limit, self.tree, self.kept, self.missing_left,
            self.first_leaf, _by_group(self.changes, groups, count), found,
        )  # fmt: skip
        return found


@dataclass(frozen=True, slots=True)
class _Question:
    term: int
    limit: float
    kept: int
    missing_left: bool


class _Tree:
    """The questions and leaves of a tree, from its nodes in depth-first order."""

    def __init__(self, nodes: list[list[Any]], names: tuple[str, ...]) -> None:
        self.questions: list[_Question] = []
        self.values: list[float] = []
        self.changes: list[list[float]] = []
        if self._walk(nodes, 0, names, [0.0] * len(names)) != len(nodes):
            raise ValueError("nodes that no branch leads to")
        if len(self.values) > MOST_LEAVES:
            raise ValueError(f"a tree of {len(self.values)} leaves, more than {MOST_LEAVES}")

    def _walk(
        self, nodes: list[list[Any]], place: int, names: tuple[str, ...], changed: list[float]
    ) -> int:
        """Take in the branch that begins at a node; return where the next one begins."""
        node = nodes[place]
        if len(node) == 1:
            self.values.append(float(node[0]))
            self.changes.append(changed)
            return place + 1
        name, limit, right, missing, mean = node
        term = names.index(name)

        def further(child: list[Any]) -> list[float]:
            more = list(changed)
            more[term] += float(child[-1]) - float(mean)
            return more

        begin = len(self.values)
        if self._walk(nodes, place + 1, names, further(nodes[place + 1])) != right:
            raise ValueError("a branch that leads out of its tree")
        # What goes right reaches no leaf of the left branch: those that it has, from `begin` on.
        struck_out = (1 << len(self.values)) - (1 << begin)
        kept = (2**MOST_LEAVES - 1) & ~struck_out
        self.questions.append(_Question(term, float(limit), kept, missing == "left"))
        return self._walk(nodes, right, names, further(nodes[right]))


@inlined
def _strike_out(
    point: npt.NDArray[np.float32],
    begins: npt.NDArray[np.int32],
    limit: npt.NDArray[np.float64],
    tree: npt.NDArray[np.int32],
    kept: npt.NDArray[np.uint64],
    missing_left: npt.NDArray[np.bool_],
    left: npt.NDArray[np.uint64],
) -> None:
    """Leave those leaves of each tree that may be reached; the first of them is."""
    left[:] = ~np.uint64(0)
    for term in range(len(point)):
        known = np.float64(point[term])
        if np.isnan(known):
            for question in range(begins[term], begins[term + 1]):
                if not missing_left[question]:
                    left[tree[question]] &= kept[question]
            continue
        for question in range(begins[term], begins[term + 1]):
            if known <= limit[question]:
                break
            left[tree[question]] &= kept[question]


@inlined
def _first(leaves: np.uint64) -> int:
    """Return the place of the lowest bit that is set."""
    lowest = leaves & (~leaves + np.uint64(1))
    return int(_PLACES[(lowest * _SEQUENCE) >> np.uint64(58)])


@compiled
def _add_up(
    evidence: npt.NDArray[np.float32],
    begins: npt.NDArray[np.int32],
    limit: npt.NDArray[np.float64],
    tree: npt.NDArray[np.int32],
    kept: npt.NDArray[np.uint64],
    missing_left: npt.NDArray[np.bool_],
    first_leaf: npt.NDArray[np.int32],
    value: npt.NDArray[np.float64],
    baseline: float,
    first: int,
    end: int,
    found: npt.NDArray[np.float32],
) -> None:
    left = np.empty(len(first_leaf) - 1, np.uint64)
    for point in range(first, end):
        _strike_out(evidence[point], begins, limit, tree, kept, missing_left, left)
        total = baseline
        for number in range(len(left)):
            total += value[first_leaf[number] + _first(left[number])]
        found[point] = total


@compiled
def _add_changes(
    evidence: npt.NDArray[np.float32],
    begins: npt.NDArray[np.int32],
    limit: npt.NDArray[np.float64],
    tree: npt.NDArray[np.int32],
    kept: npt.NDArray[np.uint64],
    missing_left: npt.NDArray[np.bool_],
    first_leaf: npt.NDArray[np.int32],
    changes: npt.NDArray[np.float64],
    found: npt.NDArray[np.float32],
) -> None:
    left = np.empty(len(first_leaf) - 1, np.uint64)
    for point in range(len(evidence)):
        _strike_out(evidence[point], begins, limit, tree, kept, missing_left, left)
        for number in range(len(left)):
            leaf = first_leaf[number] + _first(left[number])
            for group in range(found.shape[1]):
                found[point, group] += changes[leaf, group]


@compiled
def _by_group(
    changes: npt.NDArray[np.float64], groups: npt.NDArray[np.int32], count: int
) -> npt.NDArray[np.float64]:
    """Add up the changes of each group's terms, (leaves, count)."""
    found = np.zeros((len(changes), count))
    for leaf in range(len(changes)):
        for term in range(len(groups)):
            found[leaf, groups[term]] += changes[leaf, term]
    return found
