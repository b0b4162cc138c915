"""A sum of decision trees, read from a plain data file and evaluated by compiled code.

No tree is walked: each question strikes out the leaves that can no longer be reached, for a block
of points at a time, and the first leaf left of a tree is the one that a walk ends at (QuickScorer:
Lucchese et al., SIGIR 2015). The questions about one term come in the order of their limits: where
all points of the block go left, so they do at those that follow.
"""

from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from dynahull.compilation import compiled, inlined
from dynahull.errors import InvalidParametersError
from dynahull.kernels.vectors import lowest_place
from dynahull.threads import over_items

MOST_LEAVES = 32
"""Of a tree: a bit each."""

_SMALLEST_RANGE = 20_000
"""Points."""

_BLOCK = 64
"""Points at a time: their leaves stay in the cache."""


class Questions(NamedTuple):
    """What all trees ask, by term.

    Attributes
    ----------
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
    """

    begins: npt.NDArray[np.int32]
    limit: npt.NDArray[np.float32]
    tree: npt.NDArray[np.int32]
    kept: npt.NDArray[np.uint32]
    missing_left: npt.NDArray[np.bool_]
    first_leaf: npt.NDArray[np.int32]


@dataclass(frozen=True, slots=True)
class Forest:
    """Trees whose leaves add up to the logarithm of the odds that a point moved.

    Attributes
    ----------
    terms : tuple of str
        What is known of a point, in the order of the columns that the trees ask for.
    baseline : float
        What is added to the sum of the leaves.
    questions : Questions
    value : (leaves,) float64 array
        What a leaf adds.
    changes : (leaves, terms) float64 array
        What the questions about each term, on the way to a leaf, change about what is expected.
    """

    terms: tuple[str, ...]
    baseline: float
    questions: Questions
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
                [(number, *each) for number, tree in enumerate(trees) for each in tree.questions],
                dtype=[("tree", "i4"), ("term", "i4"), ("limit", "f8"), ("kept", "u4"),
                       ("missing_left", "?")],
            )  # fmt: skip
            asked = np.sort(asked, order=("term", "limit", "tree"), kind="stable")
            questions = Questions(
                np.searchsorted(asked["term"], np.arange(len(names) + 1)).astype(np.int32),
                _no_larger(asked["limit"]),
                np.ascontiguousarray(asked["tree"]),
                np.ascontiguousarray(asked["kept"]),
                np.ascontiguousarray(asked["missing_left"]),
                np.cumsum([0, *(len(tree.values) for tree in trees)]).astype(np.int32),
            )
            return cls(
                names,
                float(stored["baseline"]),
                questions,
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
        """
        found = np.empty(len(evidence), np.float32)
        add_up = partial(_add_up, evidence, self.questions, self.value, self.baseline, found)
        over_items(add_up, len(evidence), threads, _SMALLEST_RANGE)
        return found

    def ranks(self, last: npt.NDArray[np.float32]) -> npt.NDArray[np.uint16]:
        """Return how many of the limits that the trees ask about each value is beyond, (n, C).

        It takes fewer bytes than the value, and `of_ranks` makes of it what all questions answer as
        they do the value.

        Parameters
        ----------
        last : (n, C) float32 array
            Values of the last C terms.
        """
        ranks = np.empty(last.shape, np.uint16, order="F")
        for limits, values, found in zip(self._limits(last.shape[1]), last.T, ranks.T, strict=True):
            found[:] = np.where(np.isnan(values), len(limits) + 1, np.searchsorted(limits, values))
        return ranks

    def of_ranks(self, ranks: npt.NDArray[np.uint16]) -> npt.NDArray[np.float32]:
        """Return values of the last terms that have such ranks, (n, C)."""
        values = np.empty(ranks.shape, np.float32)
        for limits, own, found in zip(self._limits(ranks.shape[1]), ranks.T, values.T, strict=True):
            found[:] = np.append(limits, np.array([np.inf, np.nan], np.float32))[own]
        return values

    def _limits(self, count: int) -> list[npt.NDArray[np.float32]]:
        """Return what the trees ask about each of the last terms, ascending."""
        begins = self.questions.begins[-count - 1 :]
        return [np.unique(self.questions.limit[a:b]) for a, b in pairwise(begins)]

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
        by_group = np.zeros((len(self.changes), count))
        for term, group in enumerate(groups):
            by_group[:, group] += self.changes[:, term]
        found = np.zeros((len(evidence), count), np.float32)
        _add_changes(evidence, self.questions, by_group, found)
        return found


class _Tree:
    """The questions and leaves of a tree, from its nodes in depth-first order."""

    def __init__(self, nodes: list[list[Any]], names: tuple[str, ...]) -> None:
        self.questions: list[tuple[int, float, int, bool]] = []  # term, limit, kept, missing left
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
        self.questions.append((term, float(limit), kept, missing == "left"))
        return self._walk(nodes, right, names, further(nodes[right]))


def _no_larger(limits: npt.NDArray[np.float64]) -> npt.NDArray[np.float32]:
    """Return the largest float32 up to each limit: no float32 lies between the two."""
    nearest = limits.astype(np.float32)
    below = np.nextafter(nearest, np.float32(-np.inf))
    return np.where(nearest > limits, below, nearest)


@inlined
def _strike_out(
    evidence: npt.NDArray[np.float32],
    questions: Questions,
    known: npt.NDArray[np.float32],
    left: npt.NDArray[np.uint32],
) -> None:
    """Leave those leaves of each tree that each point may reach; the first of them it does."""
    begins, limit, tree, kept, missing_left, _ = questions
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
def _leaf(questions: Questions, left: npt.NDArray[np.uint32], tree: int, point: int) -> int:
    """Return the leaf of a tree that a point ends at: the first that is left."""
    return int(questions.first_leaf[tree]) + int(lowest_place(np.uint64(left[tree, point])))


@compiled
def _add_up(
    evidence: npt.NDArray[np.float32],
    questions: Questions,
    value: npt.NDArray[np.float64],
    baseline: float,
    found: npt.NDArray[np.float32],
    first: int,
    end: int,
) -> None:
    left = np.empty((len(questions.first_leaf) - 1, _BLOCK), np.uint32)
    known = np.empty(_BLOCK, np.float32)
    total = np.empty(_BLOCK)
    for begin in range(first, end, _BLOCK):
        block = evidence[begin : min(begin + _BLOCK, end)]
        _strike_out(block, questions, known, left)
        total[:] = baseline
        for tree in range(len(left)):
            for point in range(len(block)):
                total[point] += value[_leaf(questions, left, tree, point)]
        for point in range(len(block)):
            found[begin + point] = total[point]


@compiled
def _add_changes(
    evidence: npt.NDArray[np.float32],
    questions: Questions,
    changes: npt.NDArray[np.float64],
    found: npt.NDArray[np.float32],
) -> None:
    left = np.empty((len(questions.first_leaf) - 1, _BLOCK), np.uint32)
    known = np.empty(_BLOCK, np.float32)
    for begin in range(0, len(evidence), _BLOCK):
        block = evidence[begin : begin + _BLOCK]
        _strike_out(block, questions, known, left)
        for tree in range(len(left)):
            for point in range(len(block)):
                leaf = _leaf(questions, left, tree, point)
                for group in range(found.shape[1]):
                    found[begin + point, group] += changes[leaf, group]
