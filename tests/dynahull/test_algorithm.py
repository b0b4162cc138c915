"""Algorithm 1 as a whole: the method's formulas, the undefined cases, and the promises."""

from fractions import Fraction
from math import floor

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

import dynahull
from dynahull import Label, MethodParameters, clean
from dynahull.errors import InvalidParametersError, InvalidPointsError
from dynahull.parameters import RemovalParameters
from dynahull.reference import nearest_neighbours
from tests.listener import Listener

NO_GROUND = {"method": "none"}
DEVICES = ["reference", "cpu"]


def room(size=1500, seed=0):
    """Two dense walls and a sparse ghost between them."""
    random = np.random.default_rng(seed)
    wall = random.uniform(size=(size, 3)) * [6, 0.03, 2.5]
    other = random.uniform(size=(size // 2, 3)) * [0.03, 6, 2.5] + [8, 0, 0]
    ghost = random.uniform(size=(size // 15, 3)) * [4, 1.5, 1.8] + [1, 2, 0]
    return np.vstack([wall, other, ghost])


@pytest.mark.parametrize("device", DEVICES)
def test_every_step_follows_its_formula(device):
    points = room()
    result = clean(points, "paper", ground=NO_GROUND, density={"device": device})
    counts = np.bincount(result.cluster)
    assert counts.sum() == len(points)
    assert len(counts) == 5
    for cluster in result.clusters:
        assert cluster.count == counts[cluster.index]
        expected = (cluster.count - counts.min()) / (counts.max() - counts.min()) * 15 + 5
        assert cluster.percentage == pytest.approx(expected, rel=1e-12)
        members = np.flatnonzero(result.cluster == cluster.index)
        neighbours = nearest_neighbours(points[members], members, 75)
        volumes = [
            ConvexHull(points[members][around], qhull_options="Qt").volume for around in neighbours
        ]
        np.testing.assert_allclose(result.density[members], 75 / np.array(volumes), rtol=1e-6)
        removed = floor(Fraction(cluster.percentage) / 100 * cluster.count)
        assert cluster.removed == removed
        lowest = members[np.argsort(result.density[members], kind="stable")[:removed]]
        np.testing.assert_array_equal(
            np.sort(lowest),
            np.flatnonzero((result.labels == Label.DYNAMIC) & (result.cluster == cluster.index)),
        )
        assert cluster.threshold == result.density[lowest].max()


def test_the_ghost_goes_and_the_walls_stay():
    points = room(3000)
    ghost = slice(4500, None)
    result = clean(points, ground=NO_GROUND, clustering={"count": 1}, removal={"min_percent": 5})
    removed = result.labels == Label.DYNAMIC
    assert removed[ghost].mean() > 0.9
    assert removed[: ghost.start].mean() < 0.02


def test_counts_add_up_and_kept_is_everything_but_dynamic():
    points = room(300)
    points[::17] = np.nan
    result = clean(points, "paper", ground=NO_GROUND)
    assert sum(result.counts().values()) == len(points)
    assert result.counts()["dynamic"] == (~result.kept).sum() > 0
    assert result.removal_percentages.shape == (len(result.clusters),)


class TestUndefinedCases:
    """The table of cases that the paper leaves undefined."""

    def test_one_cluster_gets_the_minimum(self):
        result = clean(room(300), ground=NO_GROUND, clustering={"count": 1})
        assert [cluster.percentage for cluster in result.clusters] == [5.0]

    def test_equal_clusters_get_the_minimum(self):
        blob = np.random.default_rng(0).normal(size=(100, 3))
        result = clean(np.vstack([blob, blob + 50]), ground=NO_GROUND, clustering={"count": 2})
        assert [cluster.percentage for cluster in result.clusters] == [5.0, 5.0]

    def test_fewer_points_than_k_use_the_cluster_size(self):
        points = np.random.default_rng(0).normal(size=(30, 3))
        result = clean(points, ground=NO_GROUND, clustering={"count": 1})
        volume = ConvexHull(points).volume
        np.testing.assert_allclose(result.density, 30 / volume, rtol=1e-12)

    def test_a_cluster_under_four_points_is_unscored_and_kept(self):
        points = np.vstack([np.random.default_rng(0).normal(size=(40, 3)), [[500.0, 0, 0]] * 3])
        listener = Listener()
        result = clean(points, ground=NO_GROUND, clustering={"count": 2}, observer=listener)
        np.testing.assert_array_equal(result.labels[-3:], Label.UNSCORED)
        assert np.isnan(result.density[-3:]).all()
        assert any("too few for a hull" in warning for warning in listener.warnings)

    @pytest.mark.parametrize(
        "flat",
        [
            np.zeros((100, 3)),
            np.outer(np.arange(100.0), [1, 2, 3]),
            np.random.default_rng(0).uniform(size=(100, 3)) * [1, 1, 0],
        ],
        ids=["identical", "collinear", "coplanar"],
    )
    @pytest.mark.parametrize("device", DEVICES)
    def test_no_volume_is_dense_and_kept(self, flat, device):
        result = clean(flat, ground=NO_GROUND, clustering={"count": 1}, density={"device": device})
        assert np.isposinf(result.density).all()
        assert (result.labels == Label.STATIC).all()

    def test_duplicates_count(self):
        points = room(200)
        result = clean(np.repeat(points, 3, axis=0), ground=NO_GROUND, clustering={"count": 1})
        assert result.clusters[0].count == 3 * len(points)
        assert len(result.labels) == 3 * len(points)

    @pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e200])
    def test_points_that_are_not_finite_are_flagged_in_place_and_change_nothing(self, bad):
        points = room(200)
        where = np.array([0, 7, len(points)])
        spoiled = np.insert(points, where, [bad, 1.0, 2.0], axis=0)
        invalid = ~(np.abs(spoiled) < 1e150).all(axis=1)
        result, clean_result = clean(spoiled, ground=NO_GROUND), clean(points, ground=NO_GROUND)
        np.testing.assert_array_equal(result.labels == Label.INVALID, invalid)
        np.testing.assert_array_equal(result.cluster[invalid], -1)
        assert np.isnan(result.density[invalid]).all()
        assert result.counts()["dynamic"] == clean_result.counts()["dynamic"]
        np.testing.assert_array_equal(result.labels[~invalid], clean_result.labels)

    @pytest.mark.parametrize("count", [1, 2, 4])
    def test_fewer_points_than_clusters_make_fewer_clusters_and_a_warning(self, count):
        listener = Listener()
        points = np.random.default_rng(0).normal(size=(count, 3))
        result = clean(points, ground=NO_GROUND, observer=listener)
        assert len(result.clusters) == count
        assert (result.labels == Label.UNSCORED).all()
        assert any("clusters asked for" in warning for warning in listener.warnings)

    @pytest.mark.parametrize("points", [np.empty((0, 3)), np.full((5, 3), np.nan)])
    def test_nothing_to_score_passes_through_with_a_warning(self, points):
        listener = Listener()
        result = clean(points, observer=listener)
        assert result.kept.all()
        assert result.clusters == ()
        assert any("nothing was scored" in warning for warning in listener.warnings)

    def test_all_ground_passes_through(self):
        points = room(100)
        classes = np.full(len(points), 2, np.uint8)
        result = clean(points, ground={"method": "las_class"}, classification=classes)
        assert (result.labels == Label.GROUND).all()


def test_points_above_the_maximum_height_are_set_aside():
    random = np.random.default_rng(0)
    floor_points = np.column_stack([random.uniform(0, 10, (4000, 2)), random.normal(0, 0.01, 4000)])
    wall = random.uniform(size=(3000, 3)) * [10, 0.02, 4] + [0, 5, 0]
    result = clean(np.vstack([floor_points, wall]), max_height=2.0)
    above = result.labels[4000:] == Label.ABOVE
    np.testing.assert_array_equal(above[wall[:, 2] > 2.1], True)
    np.testing.assert_array_equal(above[wall[:, 2] < 1.9], False)
    assert np.isnan(result.density[4000:][above]).all()
    assert (result.labels[:4000] == Label.GROUND).mean() > 0.97


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 1e6]), st.booleans())
def test_the_result_is_the_same_every_time_and_with_any_number_of_threads(seed, shift, gridded):
    points = room(150, seed) + shift
    if gridded:
        points = np.round(points, 1)
    once, again = (clean(points, ground=NO_GROUND, threads=threads) for threads in (1, 2))
    np.testing.assert_array_equal(once.labels, again.labels)
    np.testing.assert_array_equal(once.density, again.density)
    np.testing.assert_array_equal(once.cluster, again.cluster)


def test_the_compiled_kernels_give_what_the_plain_version_gives():
    points = np.round(room(900), 3)
    plain, fast = (
        clean(points, "paper", ground=NO_GROUND, density={"device": device}) for device in DEVICES
    )
    np.testing.assert_array_equal(plain.cluster, fast.cluster)
    np.testing.assert_allclose(fast.density, plain.density, rtol=1e-9)
    # Points of one hull are equally dense but for rounding, and rounding may swap them.
    thresholds = np.array([cluster.threshold for cluster in plain.clusters])
    swapped = plain.labels != fast.labels
    at_threshold = thresholds[plain.cluster[swapped]]
    np.testing.assert_allclose(plain.density[swapped], at_threshold, rtol=1e-9)
    assert plain.counts() == fast.counts()


def test_an_observer_hears_of_every_stage_and_every_point():
    listener = Listener()
    points = room(100)
    clean(points, "paper", ground=NO_GROUND, observer=listener)
    assert list(listener.stages) == ["ground", "clustering", "density"]
    assert listener.done == listener.stages["density"] == len(points)


@pytest.mark.parametrize(
    "points",
    [[1.0, 2.0], np.zeros((4, 2)), np.zeros((4, 3), complex), [["a", "b", "c"]], [[1], [1, 2]]],
)
def test_what_is_not_a_cloud_is_refused(points):
    with pytest.raises(InvalidPointsError, match="points: expected"):
        clean(points)


def test_parameters_may_be_given_whole_or_by_section():
    points = room(100)
    parameters = MethodParameters.of({"ground": NO_GROUND, "neighbours": {"k": 20}})
    whole = clean(points, parameters)
    sections = clean(points, ground=NO_GROUND, neighbours={"k": 20})
    mixed = clean(points, parameters, neighbours={"k": 30})
    np.testing.assert_array_equal(whole.density, sections.density)
    np.testing.assert_array_equal(
        clean(points, {"ground": NO_GROUND, "neighbours": {"k": 20}}).density, whole.density
    )
    assert not np.array_equal(whole.density, mixed.density)


@pytest.mark.parametrize(
    ("given", "removal", "decision"),
    [
        (None, {}, "auto"),
        (None, {"max_percent": 8}, "paper"),
        ("paper", {"confidence": 0.7}, "paper"),
        ("indoor", {"protect_classes": (6,)}, "paper"),
        ("auto", {"max_percent": 8}, "auto"),
        (MethodParameters(), {"max_percent": 8}, "auto"),
        ({"removal": {"decision": "paper"}}, {"confidence": 0.7}, "paper"),
        ({"removal": RemovalParameters(decision="paper")}, {"confidence": 0.7}, "paper"),
    ],
)
def test_keys_of_a_section_leave_its_others_as_they_were(given, removal, decision):
    chosen = MethodParameters.chosen(given, {"removal": removal})
    assert chosen.removal.decision == decision
    assert removal.items() <= chosen.removal.model_dump().items()


@pytest.mark.parametrize("classes", [[2] * 3, [2.0] * 5, [[2] * 5], [300] * 5, [-1] * 5])
def test_classes_that_are_none_are_refused(classes):
    with pytest.raises(InvalidPointsError, match="classification: expected"):
        clean(np.zeros((5, 3)), ground={"method": "las_class"}, classification=classes)


def test_classes_may_be_a_list():
    result = clean(room(20), ground={"method": "las_class"}, classification=[2] * 31)
    assert (result.labels == Label.GROUND).all()


def test_an_unknown_section_is_refused():
    with pytest.raises(InvalidParametersError, match="did you mean neighbours"):
        clean(room(100), neighbors={"k": 20})
    with pytest.raises(InvalidParametersError, match="min_percent"):
        clean(room(100), removal={"min_percent": 30, "max_percent": 20})


def test_everything_public_can_be_imported_from_the_package():
    assert all(getattr(dynahull, name) is not None for name in dynahull.__all__)
    with pytest.raises(AttributeError, match="no attribute"):
        _ = dynahull.nonsense
