"""The scikit-learn estimator, by scikit-learn's own checks and against `clean`."""

import numpy as np
import pytest
from sklearn.base import clone
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import FunctionTransformer
from sklearn.utils.estimator_checks import parametrize_with_checks

from dynahull import DynaHull, MethodParameters, clean
from dynahull.errors import InvalidParametersError, InvalidPointsError
from dynahull.parameters import READY

OTHER_THAN_THREE = {
    "check_estimators_overwrite_params": 2,
    "check_estimators_fit_returns_self": 2,
    "check_readonly_memmap_input": 2,
    "check_n_features_in_after_fitting": 4,
    "check_positive_only_tag_during_fit": 4,
    "check_estimators_dtypes": 5,
    "check_dtype_object": 10,
    "check_outliers_fit_predict": 2,
    "check_fit_idempotent": 2,
    "check_fit_check_is_fitted": 2,
    "check_n_features_in": 2,
}
"""Checks that fit arrays of another dimension, and which; `strict` tells if one starts to pass."""


@parametrize_with_checks(
    [DynaHull(k=10, n_clusters=2)],
    expected_failed_checks=lambda _: {
        check: f"fits an array of {dimension} columns, and a map has three"
        for check, dimension in OTHER_THAN_THREE.items()
    },
)
def test_scikit_learn_checks(estimator, check):
    check(estimator)


@pytest.fixture(scope="module")
def points():
    random = np.random.default_rng(0)
    wall = random.uniform(size=(600, 3)) * [4, 0.02, 2]
    ghost = random.uniform(size=(60, 3)) * [4, 4, 2]
    return np.vstack([wall, ghost])


def test_outlier_check_of_scikit_learn_in_three_dimensions(points):
    """What `check_outliers_fit_predict` asks, on an array it could have used."""
    for array in (points, points.tolist(), points.astype(np.float32)):
        labels = DynaHull(k=20).fit_predict(array)
        assert labels.shape == (len(points),)
        assert labels.dtype.kind == "i"
        assert set(np.unique(labels)) == {-1, 1}


def test_gives_what_clean_gives(points):
    estimator = DynaHull(k=20, n_clusters=3, max_percent=25, random_state=4).fit(points)
    result = clean(
        points,
        ground={"method": "none"},
        neighbours={"k": 20},
        clustering={"count": 3, "seed": 4},
        removal={"max_percent": 25},
    )
    np.testing.assert_array_equal(estimator.labels_ == 1, result.kept)
    np.testing.assert_array_equal(estimator.density_, result.density)
    np.testing.assert_array_equal(estimator.cluster_, result.cluster)
    np.testing.assert_array_equal(estimator.removal_percentages_, result.removal_percentages)
    assert estimator.cluster_centers_.shape == (3, 3)
    assert estimator.n_features_in_ == 3


@pytest.fixture(scope="module")
def room(points):
    random = np.random.default_rng(1)
    floor = np.column_stack([random.uniform(-1, 5, (3000, 2)), random.normal(-0.5, 0.01, 3000)])
    return np.vstack([floor, points])


OWN = {
    "careful": {"removal": {"decision": "auto", "confidence": 0.9}, "neighbours": {"k": 20}},
    "sections": {"removal": {"threshold": "stepped"}, "clustering": {"count": 2, "seed": 3}},
    "a model": MethodParameters.of({"ground": {"method": "none"}, "neighbours": {"k": 30}}),
}


@pytest.mark.parametrize("name", [*READY, *OWN])
def test_of_one_configuration_the_labels_are_those_of_clean(room, name):
    configuration = OWN.get(name, name)
    estimator = clone(DynaHull(configuration=configuration, k=4, max_percent=90))
    result = clean(room, configuration)
    np.testing.assert_array_equal(estimator.fit_predict(room) == 1, result.kept)
    np.testing.assert_array_equal(estimator.score_, result.score)
    assert estimator.get_params()["configuration"] == configuration
    on_wall, density = estimator.score_samples(room[-660:-650]), result.density[-660:-650]
    np.testing.assert_allclose(on_wall, density, rtol=1e-9)


def test_evidence_is_a_decision_of_its_own(room):
    estimator = DynaHull(k=20, ground="slope", decision="auto", confidence=0.3).fit(room)
    result = clean(room, neighbours={"k": 20}, removal={"decision": "auto", "confidence": 0.3})
    np.testing.assert_array_equal(estimator.labels_ == 1, result.kept)
    assert np.isfinite(estimator.score_).sum() > 500
    assert np.isnan(DynaHull(k=20).fit(room).score_).all()


def test_a_configuration_that_is_none_is_refused(points):
    with pytest.raises(InvalidParametersError, match="expected the name of a ready configuration"):
        DynaHull(configuration="outdoors").fit(points)
    with pytest.raises(InvalidParametersError, match="did you mean removal"):
        DynaHull(configuration={"remove": {}}).fit(points)


def test_a_fitted_point_scores_its_own_density(points):
    estimator = DynaHull(k=20).fit(points)
    np.testing.assert_allclose(estimator.score_samples(points), estimator.density_, rtol=1e-9)


def test_empty_space_scores_low(points):
    estimator = DynaHull(k=20, n_clusters=1).fit(points)
    on_wall, in_space = estimator.score_samples([[2, 0.01, 1], [2, 3, 1]])
    assert in_space < on_wall / 10


def test_ground_is_neither_scored_nor_removed(points):
    random = np.random.default_rng(1)
    floor = np.column_stack([random.uniform(-1, 5, (5000, 2)), random.normal(-0.5, 0.01, 5000)])
    estimator = DynaHull(k=20, ground="slope").fit(np.vstack([floor, points]))
    ground = np.isnan(estimator.density_)
    assert ground[:5000].mean() > 0.97
    assert (estimator.labels_[ground] == 1).all()


def test_works_in_a_scikit_learn_pipeline(points):
    shift = FunctionTransformer(lambda array: array + 10)
    labels = make_pipeline(shift, DynaHull(k=20)).fit_predict(points)
    assert (labels == -1).sum() > 0


def test_other_dimensions_are_refused():
    with pytest.raises(InvalidPointsError, match=r"expected 3 features \(x, y, z\), found 2"):
        DynaHull().fit(np.zeros((10, 2)))
