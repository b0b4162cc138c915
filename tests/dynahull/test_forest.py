"""Trees: what is read from a data file is what they answer, alone, in stages, or where asked."""

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import dynahull
from dynahull.errors import InvalidParametersError
from dynahull.evidence.forest import Forest
from dynahull.evidence.model import MODELS, EvidenceModel, evidence_model
from dynahull.evidence.staged_forest import StagedForest
from dynahull.evidence.terms import TERMS

STORED = {
    "terms": ["a", "b"],
    "baseline": -1.0,
    "trees": [
        [["a", 0.5, 2, "left", 2.0], [1.0], ["b", -2.0, 4, "right", 3.0], [2.0], [4.0]],
        [[0.25]],
    ],
}


@pytest.mark.parametrize(
    ("terms", "expected"),
    [
        ([0.5, 0.0], 0.25),
        ([0.6, -2.0], 1.25),
        ([0.6, 0.0], 3.25),
        ([np.nan, 0.0], 0.25),
        ([1.0, np.nan], 3.25),
    ],
)
def test_a_forest_adds_up_its_leaves(terms, expected):
    found = Forest.of(STORED).log_odds(np.array([terms], np.float32))
    assert found.tolist() == [expected]


STAGED = STORED | {
    "quick": 1,
    "doubtful": 0.0,
    "dense": {"term": "b", "above": 7.5, "terms": ["a", "b"], "baseline": 2.0}
    | {"trees": [[["a", 0.0, 2, "left", 0.0], [-5.0], [5.0]]]},
}


def test_dense_surroundings_are_judged_by_trees_of_their_own():
    forest = StagedForest.of(STAGED)
    random = np.random.default_rng(0)
    terms = random.uniform(-9, 9, size=(300, 2)).astype(np.float32)
    terms[0], terms[1], terms[2] = [1, 7.5], [1, np.nan], [np.nan, 8]
    dense = terms[:, 1] > 7.5  # not where it is unknown
    expected = replace(forest, dense=None).log_odds(terms)
    expected[dense] = Forest.of(STAGED["dense"]).log_odds(terms[dense])
    assert forest.log_odds(terms).tolist() == expected.tolist()
    assert forest.log_odds(terms[2:3]).tolist() == [-3.0]
    for part in (dense, ~dense):  # of one sort alone
        assert forest.log_odds(terms[part]).tolist() == expected[part].tolist()
    groups = np.array([0, 1], np.int32)
    found = forest.contributions(terms, groups, 2)
    own = Forest.of(STAGED["dense"]).contributions(terms[dense], groups, 2)
    np.testing.assert_array_equal(found[dense], own)
    np.testing.assert_array_equal(
        found[~dense], forest.quick.contributions(terms, groups, 2)[~dense]
    )


@pytest.mark.parametrize(
    "dense", [{"term": "c"}, {"above": "much"}, {"terms": ["b", "a"]}, {"trees": [[[]]]}]
)
def test_trees_for_dense_surroundings_are_whole_or_refused(dense):
    with pytest.raises(InvalidParametersError, match="trees: expected"):
        StagedForest.of(STAGED | {"dense": STAGED["dense"] | dense})


def stored_model():
    return json.loads((Path(dynahull.__file__).parent / "evidence" / "model.json").read_text())


def walked(stored, terms):
    """What the trees say of one point, each walked from its root."""
    total = stored["baseline"]
    for tree in stored["trees"]:
        place = 0
        while len(tree[place]) > 1:
            term, limit, right, missing, _ = tree[place]
            known = float(terms[stored["terms"].index(term)])
            left = missing == "left" if np.isnan(known) else known <= limit
            place = place + 1 if left else right
        total += tree[place][0]
    return np.float32(total)


@given(st.integers(0, 2**32 - 1), st.sampled_from(["first", "second"]))
@settings(deadline=None, max_examples=25)
def test_the_odds_are_those_of_trees_that_are_walked(seed, which):
    """At the limits themselves, beside them, and where a term is missing."""
    stored, random = stored_model()[which], np.random.default_rng(seed)
    stored["trees"] = stored["trees"][random.integers(8) :: 8]
    limits = {name: [0.0] for name in stored["terms"]}
    for tree in stored["trees"]:
        for node in tree[:-1]:
            if len(node) > 1:
                limits[node[0]].append(node[1])
    terms = np.array([random.choice(values, 20) for values in limits.values()], np.float32).T
    terms += random.choice(np.array([-0.1, 0, 0, 0.1], np.float32), terms.shape)
    terms[random.random(terms.shape) < 0.05] = np.nan
    found = Forest.of(stored).log_odds(np.ascontiguousarray(terms))
    assert found.tolist() == [walked(stored, row) for row in terms]


@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from(sorted(MODELS)),
    st.sampled_from([np.nan, np.inf, -np.inf, 0.0]),
)
@settings(deadline=None, max_examples=25)
def test_ranks_of_terms_answer_all_questions_as_the_terms_do(seed, name, odd):
    model, random = evidence_model(name), np.random.default_rng(seed)
    questions = model.second.questions
    terms = np.array(
        [
            random.choice(np.append(questions.limit[begin:end], np.float32(0.5)), 60)
            for begin, end in pairwise(questions.begins)
        ],
        np.float32,
    ).T
    terms += random.choice(np.array([-1e-3, 0, 0, 1e-3], np.float32), terms.shape)
    terms[random.random(terms.shape) < 0.1] = odd
    kept = len(model.asked.kept)
    ranks = model.second.ranks(terms[:, -kept:])
    told = np.column_stack([terms[:, :-kept], model.second.of_ranks(ranks)])
    assert model.second.log_odds(told).tolist() == model.second.log_odds(terms.copy()).tolist()


def test_contributions_are_what_each_question_changes():
    found = Forest.of(STORED).contributions(
        np.array([[1.0, 0.0]], np.float32), np.array([0, 1], np.int32), 2
    )
    assert found.tolist() == [[1.0, 1.0]]  # 2 to 3 by the first term, 3 to 4 by the second


def test_contributions_and_baseline_add_up_to_the_odds():
    stored = stored_model()["first"]
    forest = Forest.of(stored)
    terms = np.random.default_rng(0).normal(size=(50, len(TERMS))).astype(np.float32)
    groups = np.zeros(len(TERMS), np.int32)
    expected = forest.baseline + sum(tree[0][-1] for tree in stored["trees"])
    shares = forest.contributions(terms, groups, 1)[:, 0]
    assert np.allclose(expected + shares, forest.log_odds(terms), atol=1e-3)


def test_most_trees_are_asked_about_doubtful_points_only():
    stored = {
        "terms": ["a"],
        "baseline": -1.0,
        "trees": [
            [["a", 0.0, 2, "left", 0.0], [-3.0], [2.0]],
            [["a", 1.0, 2, "left", 0.0], [-9.0], [2.0]],
        ],
        "quick": 1,
        "doubtful": -2.0,
    }
    terms = np.array([[-1.0], [0.5], [2.0]], np.float32)
    forest = StagedForest.of(stored)
    # The first is not doubtful. The second is, and stays so, less likely than that as it is.
    assert forest.log_odds(terms).tolist() == [-4.0, -2.0, 3.0]
    assert StagedForest.of(stored | {"doubtful": -4.5}).log_odds(terms).tolist() == [
        -4.5,
        -4.5,
        3.0,
    ]
    for missing in ("quick", "doubtful"):
        with pytest.raises(InvalidParametersError, match="expected stages"):
            StagedForest.of({name: stored[name] for name in stored if name != missing})


def test_likely_points_are_judged_by_other_trees_and_stay_likely():
    stored = {
        "terms": ["a"],
        "baseline": 0.0,
        "trees": [[["a", 1.0, 2, "left", 0.0], [-3.0], [2.0]]],
        "quick": 1,
        "doubtful": -2.0,
        "likely": {
            "above": -1.0,
            "terms": ["a"],
            "baseline": 0.5,
            "trees": [[["a", 2.0, 2, "left", 0.0], [-9.0], [4.0]]],
        },
    }
    terms = np.array([[0.0], [1.5], [3.0]], np.float32)
    # The first is not likely. The second is, and stays so, less likely than that as it is.
    assert StagedForest.of(stored).log_odds(terms).tolist() == [-3.0, -1.0, 4.5]
    for wrong in ({"terms": ["b"]}, {"above": "much"}, {"trees": [[[]]]}):
        with pytest.raises(InvalidParametersError):
            StagedForest.of(stored | {"likely": stored["likely"] | wrong})


@given(st.integers(0, 2**32 - 1), st.floats(-6, 2), st.floats(-4, 2))
@settings(deadline=None, max_examples=25)
def test_stages_give_the_odds_of_their_forests(seed, doubtful, limit):
    stored = stored_model()["first"] | {"doubtful": doubtful, "quick": 15}
    likely = stored["likely"] | {"above": limit, "trees": stored["likely"]["trees"][::10]}
    stored["trees"] = stored["trees"][::5]
    terms = np.random.default_rng(seed).normal(size=(200, len(TERMS))).astype(np.float32)
    quick = Forest.of(stored | {"trees": stored["trees"][: stored["quick"]]}).log_odds(terms)
    whole = Forest.of(stored).log_odds(terms)
    bound = np.float32(doubtful)
    expected = np.where(quick > bound, np.maximum(whole, bound), quick)
    two = StagedForest.of({name: stored[name] for name in stored if name != "likely"})
    found = two.log_odds(terms)
    np.testing.assert_allclose(found, expected, atol=1e-5)
    judged = np.maximum(Forest.of(likely).log_odds(terms), np.float32(limit))
    expected = np.where(found > np.float32(limit), judged, found)
    three = StagedForest.of(stored | {"likely": likely})
    np.testing.assert_array_equal(three.log_odds(terms), expected)


@pytest.mark.parametrize(
    "trees",
    [
        [[["a", 0.5, 9, "left", 1.5], [1.0], [2.0]]],
        [[["a", 0.5, 0, "left", 1.5], [1.0], [2.0]]],
        [[["c", 0.5, 2, "left", 1.5], [1.0], [2.0]]],
        [[["a", 0.5, 2, "left", 1.5], [1.0]]],
        [[["a", 0.5, 2, "left", 1.5], [1.0], [2.0], [3.0]]],
        [[node for n in range(64) for node in (["a", n, 2 * n + 2, "left", 1.5], [1.0])] + [[2.0]]],
        "trees",
    ],
)
def test_trees_that_are_not_whole_are_refused(trees):
    with pytest.raises(InvalidParametersError, match="expected whole ones"):
        Forest.of(STORED | {"trees": trees})


def test_a_model_of_other_terms_is_refused():
    staged = STORED | {"quick": 1, "doubtful": -2.0}
    with pytest.raises(InvalidParametersError, match="expected the terms of this version"):
        EvidenceModel.of({"first": staged, "second": STORED})
