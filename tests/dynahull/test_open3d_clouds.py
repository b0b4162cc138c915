"""Clouds of Open3D are taken as they are, and nobody else waits for Open3D."""

import subprocess
import sys

import numpy as np
import pytest

from dynahull import DynaHull, InvalidPointsError, clean

PARAMETERS = {
    "ground": {"method": "none"},
    "neighbours": {"k": 20},
    "removal": {"decision": "paper"},
}


@pytest.fixture(scope="module")
def open3d():
    reason = "Open3D is not installed, or cannot be imported"
    return pytest.importorskip("open3d", reason=reason, exc_type=ImportError)


@pytest.fixture(scope="module")
def points():
    return np.random.default_rng(0).uniform(size=(400, 3)) * [4, 0.5, 2]


def legacy(open3d, points):
    return open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))


def tensor(open3d, points):
    return open3d.t.geometry.PointCloud(open3d.core.Tensor(points))


def test_a_cloud_is_cleaned_as_its_points_are(open3d, points):
    cloud = legacy(open3d, points)
    result, expected = clean(cloud, PARAMETERS), clean(points, PARAMETERS)
    np.testing.assert_array_equal(result.labels, expected.labels)
    np.testing.assert_array_equal(result.density, expected.density)
    cleaned = cloud.select_by_index(np.flatnonzero(result.kept))
    np.testing.assert_array_equal(np.asarray(cleaned.points), points[expected.kept])
    assert 0 < len(cleaned.points) < len(points)
    np.testing.assert_array_equal(np.asarray(cloud.points), points)


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_so_is_a_cloud_of_tensors(open3d, points, kind):
    cloud = tensor(open3d, points.astype(kind))
    result, expected = clean(cloud, PARAMETERS), clean(points.astype(kind), PARAMETERS)
    np.testing.assert_array_equal(result.labels, expected.labels)
    np.testing.assert_array_equal(result.density, expected.density)


@pytest.mark.parametrize("make", [legacy, tensor])
def test_it_is_given_back_without_its_ghosts(open3d, points, make):
    cloud = make(open3d, points)
    result = clean(cloud, PARAMETERS)
    found = result.cleaned(cloud)
    assert type(found) is type(cloud)
    xyz = found.points if make is legacy else found.point.positions.numpy()
    np.testing.assert_array_equal(np.asarray(xyz), points[result.indices])


@pytest.mark.parametrize("make", [legacy, tensor])
def test_evidence_is_weighed_of_clouds(open3d, points, make):
    result, expected = clean(make(open3d, points), "auto"), clean(points, "auto")
    np.testing.assert_array_equal(result.score, expected.score)


@pytest.mark.parametrize("make", [legacy, tensor])
def test_the_estimator_takes_them(open3d, points, make):
    cloud = make(open3d, points)
    estimator = DynaHull(configuration=PARAMETERS)
    labels = estimator.fit_predict(cloud)
    np.testing.assert_array_equal(labels, DynaHull(configuration=PARAMETERS).fit_predict(points))
    np.testing.assert_array_equal(estimator.score_samples(cloud), estimator.score_samples(points))


def test_a_cloud_without_points_is_one_of_none(open3d):
    for cloud in (open3d.geometry.PointCloud(), open3d.t.geometry.PointCloud()):
        assert len(clean(cloud).labels) == 0


def test_other_things_of_open3d_are_refused_in_one_line(open3d, points):
    with pytest.raises(InvalidPointsError, match="points"):
        clean(open3d.geometry.LineSet())
    assert len(clean(points, PARAMETERS).labels) == len(points)


def test_open3d_is_not_imported_for_arrays():
    code = (
        "import sys, numpy, dynahull; dynahull.clean(numpy.eye(3)); print('open3d' in sys.modules)"
    )
    said = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert said.stdout.strip() == "False"
