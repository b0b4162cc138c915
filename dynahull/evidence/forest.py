"""A sum of decision trees, read from a plain data file and evaluated by compiled code.

No tree is walked: each question strikes out the leaves that can no longer be reached, for a block
of points at a time, and the first leaf left of a tree is the one that a walk ends at (QuickScorer:
Lucchese et al., SIGIR 2015). The questions about one term come in the order of their limits: where
all points of the block go left, so they do at those that follow.
"""

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from dynahull.compilation import compiled, inlined
from dynahull.errors import InvalidParametersError
from dynahull.threads import over_ranges, range_bounds

MOST_LEAVES = 32
"""Of a tree: a bit each."""

_SMALLEST_RANGE = 20_000
"""Points."""

_BLOCK = 64
"""Points at a time: their leaves stay in the cache."""

_SEQUENCE = np.uint32(0x077CB531)
"""Of de Bruijn: each of its 32 windows of five bits is another number."""

_PLACES = np.zeros(32, np.int32)
_PLACES[[(int(_SEQUENCE) << place) % 2**32 >> 27 for place in range(32)]] = np.arange(32)


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
    limit : (questions,) float32 array
        What is no larger goes left; ascending for each term.
    tree : (questions,) int32 array
        The tree of a question.
    kept : (questions,) uint32 array
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
    limit: npt.NDArray[np.float32]
    tree: npt.NDArray[np.int32]
    kept: npt.NDArray[np.uint32]
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
            kept = np.array([each.kept for tree in trees for each in tree.questions], np.uint32)
            order = np.argsort(asked, order=("term", "limit", "tree"), kind="stable")
            asked, kept = asked[order], kept[order]
            return cls(
                names,
                float(stored["baseline"]),
                np.searchsorted(asked["term"], np.arange(len(names) + 1)).astype(np.int32),
                _no_larger(asked["limit"]),
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


def _no_larger(limits: npt.NDArray[np.float64]) -> npt.NDArray[np.float32]:
    """Return the largest float32 up to each limit: no float32 lies between the two."""
    nearest = limits.astype(np.float32)
    below = np.nextafter(nearest, np.float32(-np.inf))
    return np.where(nearest > limits, below, nearest)


@inlined
def _strike_out(
    evidence: npt.NDArray[np.float32],
    begins: npt.NDArray[np.int32],
    limit: npt.NDArray[np.float32],
    tree: npt.NDArray[np.int32],
    kept: npt.NDArray[np.uint32],
    missing_left: npt.NDArray[np.bool_],
    known: npt.NDArray[np.float32],
    left: npt.NDArray[np.uint32],
) -> None:
    """Leave those leaves of each tree that each point may reach; the first of them it does."""
    count = len(evidence)
    all_leaves = np.uint32(2**MOST_LEAVES - 1)
    left[:] = all_leaves
    known[:] = np.float32(-np.inf)  # where the block has no point
    for term in range(evidence.shape[1]):
        missing = False
        most = np.float32(-np.inf)
        for point in range(count):
            known[point] = evidence[point, term]
            missing |= np.isnan(known[point])
            most = max(most, known[point])
        for question in range(begins[term], begins[term + 1]):
            bound, keeps, leaves = limit[question], kept[question], left[tree[question]]
            if missing and not missing_left[question]:
                for point in range(_BLOCK):
                    leaves[point] &= all_leaves if known[point] <= bound else keeps
            elif missing or most > bound:
                for point in range(_BLOCK):
                    leaves[point] &= keeps if known[point] > bound else all_leaves
            else:
                break


@inlined
def _first(leaves: np.uint32) -> int:
    """Return the place of the lowest bit that is set."""
    lowest = np.uint32(leaves & (~leaves + np.uint32(1)))
    return int(_PLACES[np.uint32(lowest * _SEQUENCE) >> np.uint32(27)])


@compiled
def _add_up(
    evidence: npt.NDArray[np.float32],
    begins: npt.NDArray[np.int32],
    limit: npt.NDArray[np.float32],
    tree: npt.NDArray[np.int32],
    kept: npt.NDArray[np.uint32],
    missing_left: npt.NDArray[np.bool_],
    first_leaf: npt.NDArray[np.int32],
    value: npt.NDArray[np.float64],
    baseline: float,
    first: int,
    end: int,
    found: npt.NDArray[np.float32],
) -> None:
    left = np.empty((len(first_leaf) - 1, _BLOCK), np.uint32)
    known = np.empty(_BLOCK, np.float32)
    total = np.empty(_BLOCK)
    for begin in range(first, end, _BLOCK):
        block = evidence[begin : min(begin + _BLOCK, end)]
        _strike_out(block, begins, limit, tree, kept, missing_left, known, left)
        total[:] = baseline
        for number in range(len(left)):
            for point in range(len(block)):
                total[point] += value[first_leaf[number] + _first(left[number, point])]
        for point in range(len(block)):
            found[begin + point] = total[point]


@compiled
def _add_changes(
    evidence: npt.NDArray[np.float32],
    begins: npt.NDArray[np.int32],
    limit: npt.NDArray[np.float32],
    tree: npt.NDArray[np.int32],
    kept: npt.NDArray[np.uint32],
    missing_left: npt.NDArray[np.bool_],
    first_leaf: npt.NDArray[np.int32],
    changes: npt.NDArray[np.float64],
    found: npt.NDArray[np.float32],
) -> None:
    left = np.empty((len(first_leaf) - 1, _BLOCK), np.uint32)
    known = np.empty(_BLOCK, np.float32)
    for begin in range(0, len(evidence), _BLOCK):
        block = evidence[begin : begin + _BLOCK]
        _strike_out(block, begins, limit, tree, kept, missing_left, known, left)
        for number in range(len(left)):
            for point in range(len(block)):
                leaf = first_leaf[number] + _first(left[number, point])
                for group in range(found.shape[1]):
                    found[begin + point, group] += changes[leaf, group]


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
