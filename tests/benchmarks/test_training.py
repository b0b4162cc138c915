"""The trees that are written are those that were learnt, and figures are counted right."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.training.dense import _make, standing_parameters
from benchmarks.training.fitting import (
    DENSE,
    DENSE_TERM,
    FOLDS,
    DenseLesson,
    FitOptions,
    Lesson,
    Sample,
    averaged,
    boosted,
    fit_seconds,
    fold_of,
    stored,
    train,
)
from benchmarks.training.judging import (
    Judged,
    ablation,
    dense_figures,
    figures,
    judge,
    reliability,
)
from benchmarks.training.maps import MOVED, STATIC, UNKNOWN, TrainingMap
from dynahull.evidence.forest import Forest
from dynahull.evidence.model import MAP_ONLY, TIMED, EvidenceModel
from dynahull.evidence.staged_forest import StagedForest
from dynahull.evidence.terms import FALLING, RISING, SEEN_TERMS, TERMS, TIMED_TERMS
from pipeline.simulation.meshes import DriveMode, MeshSceneKind

DENSITY = TERMS.index("density_1.2")
SMALL = FitOptions(
    points=600,
    first_trees=10,
    first_leaves=6,
    quick_trees=3,
    dense_trees=7,
    dense_leaves=5,
    second_trees=8,
    second_leaves=5,
)


def a_map(number, kind, count=2_000):
    """A map in which what is less dense than its surroundings moved, mostly."""
    random = np.random.default_rng(number)
    # In tenths: of more values than bins, scikit-learn seeks percentiles, for seconds.
    terms = random.normal(size=(count, len(TIMED_TERMS))).round(1).astype(np.float32)
    terms[random.random(terms.shape) < 0.05] = np.nan
    likely = np.nan_to_num(-terms[:, DENSITY]) + 0.3 * random.normal(size=count) > 1
    truth = np.where(likely, MOVED, STATIC).astype(np.int8)
    xyz = random.uniform(size=(count, 3)) * [20, 20, 2]
    return TrainingMap(f"{number:05d}a", kind, "vlp16", xyz, truth, terms, 500, 3)


def test_with_poses_what_scans_saw_is_that_of_the_poses():
    table = np.arange(2.0 * (len(TIMED_TERMS) + len(SEEN_TERMS)), dtype=np.float32).reshape(2, -1)
    posed = replace(a_map(0, "office", 2), terms=table).posed()
    expected = np.delete(table, np.s_[len(TIMED_TERMS) - len(SEEN_TERMS) : len(TIMED_TERMS)], 1)
    assert posed.terms.shape == expected.shape == (2, len(TIMED_TERMS))
    assert len(posed.terms) == 2
    np.testing.assert_array_equal(posed.terms[:1], expected[:1])
    np.testing.assert_array_equal(posed.terms[:, np.array([80, 3])], expected[:, [80, 3]])


def lesson(count=4_000):
    each = a_map(0, "office", count)
    return Lesson(each.terms, each.truth == MOVED, np.ones(count))


def test_the_stored_trees_give_the_odds_of_those_that_were_learnt():
    learnt = lesson()
    model = boosted(learnt, TIMED_TERMS, 20, 12)
    found = Forest.of(stored(model, TIMED_TERMS)).log_odds(learnt.terms)
    same = np.isclose(found, model.decision_function(learnt.terms), atol=1e-3)
    # Limits are kept to nine digits: a term that is just a limit may go the other way.
    assert same.mean() > 0.995


@pytest.mark.parametrize(("names", "sign"), [(RISING, 1), (FALLING, -1)])
def test_what_physics_says_of_a_term_holds(names, sign):
    forest = Forest.of(stored(boosted(lesson(), TIMED_TERMS, 20, 12), TIMED_TERMS))
    terms = lesson(500).terms
    for name in names:
        low, high = terms.copy(), terms.copy()
        low[:, TIMED_TERMS.index(name)], high[:, TIMED_TERMS.index(name)] = -1.5, 1.5
        change = forest.log_odds(high) - forest.log_odds(low)
        assert (sign * change >= -1e-5).all()


def test_a_sample_gives_each_map_its_own_shares():
    truth = np.repeat(np.array([UNKNOWN, STATIC, MOVED], np.int8), [50, 900, 50])
    sample = Sample.of(truth, 90, np.random.default_rng(0))
    moved = truth[sample.rows] == MOVED
    assert moved.sum() == 30 and (truth[sample.rows] != UNKNOWN).all()
    assert sample.weights.sum() == pytest.approx(90)
    assert sample.weights[moved].sum() / 90 == pytest.approx(50 / 950)


def test_every_kind_of_scene_is_left_out_once():
    kinds = [kind for kinds in FOLDS for kind in kinds]
    assert len(kinds) == len(set(kinds))
    assert [fold_of(a_map(0, kind, 10)) for kind in ("office", "boxes_ramp")] == [0, 4]


@pytest.mark.parametrize("asked", [MAP_ONLY, TIMED])
def test_training_finds_what_moved_on_kinds_left_out(asked):
    maps = [a_map(number, kinds[0]) for number, kinds in enumerate(FOLDS)]
    training = train(maps, SMALL, workers=1, asked=asked)
    seconds = fit_seconds(training, SMALL, workers=1)
    judged = judge(training, seconds, workers=1)
    assert [each.name for each in judged] == [each.name for each in maps]
    assert min(each.f1(0.5) for each in judged) > 60
    assert len(list(figures(judged, 0.5))) == 2 + len(FOLDS)
    earned = list(ablation(training, workers=1))
    assert earned[1].startswith("density_1.2")
    EvidenceModel.of(
        {"first": averaged(training.first), "second": averaged(seconds)}
    )  # what is written is what the package reads


def dense_lesson(number, kind, count=2_000):
    """Among dense surroundings, what is thick moved; elsewhere, that says nothing."""
    terms = a_map(number, kind, count).terms[:, : len(TERMS)]
    terms[:, TERMS.index(DENSE_TERM)] = DENSE + 1
    thickness = np.nan_to_num(terms[:, TERMS.index("thickness")])
    return DenseLesson(kind, Lesson(terms, thickness > 1, np.ones(count)))


def test_dense_surroundings_have_trees_of_their_own():
    maps = [a_map(number, kinds[0]) for number, kinds in enumerate(FOLDS)]
    dense = [dense_lesson(10 + number, kinds[0]) for number, kinds in enumerate(FOLDS)]
    training = train(maps, SMALL, workers=1, dense=dense)
    without = train(maps, SMALL, workers=1)
    table = [line.split() for line in dense_figures(training, dense, 0.5)]
    f1 = [float(line[-3]) for line in table[1:]]
    assert f1[0] > 80 and f1[1] < 40  # by them, and by all others
    whole, plain = averaged(training.first), averaged(without.first)
    assert [*whole] == [*plain, "dense"]
    assert {name: whole[name] for name in plain} == plain  # the others learn nothing from them
    assert len(whole["dense"]["trees"]) == len(FOLDS) * SMALL.dense_trees
    assert [each["dense"]["trees"] for each in training.first[:2]] != 2 * [
        training.first[0]["dense"]["trees"]
    ]  # each lacks another kind


def test_scenes_of_sensors_that_stand_are_measured_once(tmp_path, monkeypatch):
    pytest.importorskip("open3d", reason="the extra `open3d` is not installed")
    few = {"scans": 20, "rays": 8_000, "people": 3}
    small = standing_parameters(0).model_copy(update=few)
    assert small.mode == DriveMode.STAND and small.kind == MeshSceneKind.ROOM
    monkeypatch.setattr("benchmarks.training.dense.standing_parameters", lambda _: small)
    monkeypatch.setattr("benchmarks.training.dense.DENSE", 4.0)
    path = _make(tmp_path, 0)
    with np.load(path) as kept:
        assert len(kept["terms"]) == len(kept["moved"]) == len(kept["weights"]) > 1_000
        assert (kept["terms"][:, TERMS.index(DENSE_TERM)] > 4).all()
        assert 0 < kept["moved"].mean() < 0.7
    before = path.stat().st_mtime_ns
    assert _make(tmp_path, 0) == path and path.stat().st_mtime_ns == before
    assert [each.name for each in tmp_path.iterdir()] == [path.name]


def test_the_mean_of_models_has_the_mean_of_their_log_odds():
    models = [stored(boosted(lesson(), TIMED_TERMS, 20, leaves), TIMED_TERMS) for leaves in (4, 12)]
    terms = lesson().terms
    odds = [Forest.of(model).log_odds(terms) for model in models]
    found = Forest.of(averaged(models)).log_odds(terms)
    assert np.allclose(found, np.mean(odds, axis=0), atol=1e-3)
    stages = [model | {"quick": 5, "doubtful": -1.0} for model in models]
    quick = [Forest.of(model | {"trees": model["trees"][:5]}).log_odds(terms) for model in models]
    together = StagedForest.of(averaged(stages))
    assert np.allclose(together.quick.log_odds(terms), np.mean(quick, axis=0), atol=1e-3)
    rest = together.rest.log_odds(terms) + together.quick.log_odds(terms)
    assert np.allclose(rest, np.mean(odds, axis=0), atol=1e-3)


def test_figures_are_counted_over_all_points():
    truth = np.repeat(np.array([STATIC, MOVED, UNKNOWN], np.int8), [80, 20, 7])
    each = a_map(0, "office", 107)
    odds = np.full(107, -3.0, np.float32)
    odds[76:95] = 3.0  # 4 static, 15 moved
    made = TrainingMap(each.name, "office", "os64", each.xyz, truth, each.terms, 20, 5)
    judged = Judged.of(made, odds)
    assert judged.f1(0.5) == pytest.approx(200 * 15 / (19 + 25))
    assert judged.lost(0.5) == pytest.approx(4.0)
    assert judged.accuracy(0.5) == pytest.approx(100 * np.sqrt(0.6 * 0.96))
    assert judged.share == pytest.approx(25 / 125)
    expected = pytest.approx((0.9525, 15 / 19, 19), abs=0.003)
    assert reliability([judged])[-1] == expected
    unknown = replace(made, truth=np.zeros_like(truth))
    assert reliability([judged, Judged.of(unknown, odds)])[-1] == expected
