"""Few trees say what many said, find what is likely, and nothing else is learnt."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.training.distilling import LIKELY, ask, learn
from benchmarks.training.fitting import FOLDS, averaged, fit_seconds, train
from dynahull.evidence.forest import Forest
from dynahull.evidence.model import MAP_ONLY, TIMED, EvidenceModel
from tests.benchmarks.test_training import SMALL, a_map, dense_lesson

FEW = replace(SMALL, points=3_000, first_trees=30, first_leaves=12)


def many(asked, dense=()):
    maps = [a_map(number, kinds[0]) for number, kinds in enumerate(FOLDS)]
    training = train(maps, SMALL, workers=1, asked=asked, dense=dense)
    seconds = fit_seconds(training, SMALL, workers=1)
    return {"first": averaged(training.first), "second": averaged(seconds)}


@pytest.mark.parametrize("asked", [MAP_ONLY, TIMED])
def test_few_trees_say_what_many_said_of_maps_that_they_have_not_seen(asked):
    model = many(asked)
    told = [ask(a_map(20 + number, "office", 4_000), model, FEW) for number in range(6)]
    few = EvidenceModel.of(learn(model, told, FEW))
    assert few.asked == asked
    said = ask(a_map(50, "office"), model, FEW)
    found = replace(few.first, likely=None).log_odds(said.terms)
    assert np.corrcoef(found, said.odds)[0, 1] > 0.97
    assert ((found > 0) == (said.odds > 0)).mean() > 0.97
    likely, both = found > LIKELY, few.first.log_odds(said.terms)
    assert likely.any() and not likely.all()
    np.testing.assert_array_equal(both[~likely], found[~likely])
    many_say = Forest.of(model["first"]).log_odds(said.terms)
    np.testing.assert_array_equal(both[likely], np.maximum(many_say[likely], LIKELY))


def test_a_third_of_the_points_that_are_asked_about_are_doubtful():
    model, options = many(MAP_ONLY), replace(FEW, points=300)
    said = ask(a_map(50, "office", 4_000), model, options)
    assert len(said.odds) == len(said.terms) and 250 < len(said.odds) <= 300
    assert (said.odds > options.doubtful).sum() >= 100


def test_all_but_the_first_round_stays_and_its_limit_of_doubt_does():
    dense = [dense_lesson(10 + number, kinds[0]) for number, kinds in enumerate(FOLDS)]
    model = many(MAP_ONLY, dense)
    model["first"]["doubtful"] = -2.5
    few = learn(model, [ask(a_map(20, "office"), model, FEW)], FEW)
    first = few["first"]
    assert few["second"] == model["second"] and first["dense"] == model["first"]["dense"]
    assert first["doubtful"] == -2.5
    assert (first["quick"], len(first["trees"])) == (FEW.quick_trees, FEW.first_trees)
    assert first["likely"]["trees"] == model["first"]["trees"]
    assert first["likely"]["baseline"] == model["first"]["baseline"]
