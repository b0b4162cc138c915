"""Whatever is given as points works, or ends at once in one line that says what to pass."""

import time
from importlib import import_module

import laspy
import numpy as np
import pytest

import dynahull
from dynahull import DynaHull, InvalidParametersError, InvalidPointsError, MethodParameters, clean
from dynahull.parameters import READY
from pipeline.configuration.run import load_configuration, ready_configurations

POINTS = np.random.default_rng(0).normal(size=(300, 3))
FAST = {"ground": {"method": "none"}}


class Slow:
    """Gives its items one by one, as laspy's data does, and never ends."""

    def __len__(self):
        return 10**9

    def __getitem__(self, item):
        return Slow()


class Tensor:
    """Hands its numbers out only when it may."""

    def __array__(self, dtype=None, copy=None):
        raise RuntimeError("Can't call numpy() on a tensor\nthat requires grad")


def table(columns):
    return import_module("pandas").DataFrame(POINTS[:, : len(columns)], columns=columns)


def structured():
    return np.zeros(5, dtype=[("x", "f8"), ("y", "f8"), ("z", "f8")])


REFUSED = {
    "items without an end": (Slow, "of type Slow"),
    "a list of such": (lambda: [Slow()], "items that are Slow"),
    "a generator": (lambda: (row for row in POINTS), "pass a list of it"),
    "None": (lambda: None, "found None"),
    "a path": (lambda: "map.las", "files are read by"),
    "a number": (lambda: 5, "of type int"),
    "a dictionary": (lambda: {"x": [1]}, "of type dict"),
    "a set": (lambda: {1.0, 2.0}, "of type set"),
    "a tensor": (Tensor, "Can't call numpy"),
    "four columns": (lambda: np.ones((9, 4)), r"points\[:, :3\]"),
    "a table without x": (lambda: table(["a", "y", "z"]).assign(i=1), "name x, y and z among"),
    "the wrong way round": (lambda: np.ones((3, 600)), r"points\.T"),
    "organised": (lambda: np.ones((8, 9, 3)), r"points\.reshape\(-1, 3\)"),
    "structured": (structured, "numpy.column_stack"),
    "objects": (lambda: POINTS.astype(object), r"astype\(float\)"),
    "complex": (lambda: POINTS.astype(complex), "found dtype complex128"),
    "true or false": (lambda: POINTS > 0, "found dtype bool"),
    "text": (lambda: [["a", "b", "c"]], "found dtype"),
    "ragged": (lambda: [[1.0], [1.0, 2.0]], "inhomogeneous"),
    "flat": (lambda: [1.0, 2.0, 3.0], r"found shape \(3,\)"),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_what_is_no_cloud_is_refused_at_once(kind):
    make, remedy = REFUSED[kind]
    begun = time.perf_counter()
    with pytest.raises(InvalidPointsError, match=remedy) as refused:
        clean(make())
    assert time.perf_counter() - begun < 5
    assert "\n" not in str(refused.value)
    assert len(str(refused.value)) < 400


@pytest.mark.parametrize(
    "kind", ["items without an end", "a generator", "None", "four columns", "tensor"]
)
def test_the_estimator_refuses_at_once_too(kind):
    make, _ = REFUSED.get(kind, (Tensor, ""))
    with pytest.raises(InvalidPointsError, match="X: "):
        DynaHull().fit(make())


@pytest.mark.parametrize(
    "columns", [["x", "y", "z", "i"], ["z", "y", "x"], ["i", "X", "Y", "Z"]], ids="".join
)
def test_of_a_table_x_y_and_z_are_taken(columns):
    pytest.importorskip("pandas", reason="pandas is not installed")
    values = {"i": POINTS[:, 0], **dict(zip("xyz", POINTS.T, strict=True))}
    frame = import_module("pandas").DataFrame({name: values[name.lower()] for name in columns})
    result = clean(frame, FAST)
    np.testing.assert_array_equal(result.labels, clean(POINTS, FAST).labels)
    assert len(result.cleaned(frame)) == result.kept.sum()
    np.testing.assert_array_equal(DynaHull().fit_predict(frame), DynaHull().fit_predict(POINTS))


def test_data_of_laspy_is_taken_and_given():
    las = laspy.create(point_format=3, file_version="1.4")
    las.xyz = POINTS
    las.intensity = np.arange(len(POINTS))
    result = clean(las, FAST)
    np.testing.assert_array_equal(result.labels, clean(las.xyz, FAST).labels)
    cleaned = result.cleaned(las)
    np.testing.assert_array_equal(cleaned.intensity, np.flatnonzero(result.kept))
    np.testing.assert_array_equal(cleaned.xyz, las.xyz[result.kept])


def test_a_tensor_is_taken_from_any_device():
    """PyTorch's own way to numbers; a tensor on a GPU, or one that learns, has no other."""

    class OnDevice(Tensor):
        def detach(self):
            return self

        def cpu(self):
            return self

        def numpy(self):
            return POINTS

    np.testing.assert_array_equal(clean(OnDevice(), FAST).labels, clean(POINTS, FAST).labels)


def test_arrays_and_lists_are_given_back():
    result = clean(POINTS, FAST)
    np.testing.assert_array_equal(result.cleaned(POINTS), POINTS[result.kept])
    np.testing.assert_array_equal(result.cleaned(POINTS.tolist()), POINTS[result.indices])
    with pytest.raises(InvalidPointsError, match=r"expected the 300 points .* found 299"):
        result.cleaned(POINTS[1:])


TAKEN = {
    "lists": POINTS.tolist,
    "tuples": lambda: [tuple(row) for row in POINTS.tolist()],
    "a memory view": lambda: memoryview(POINTS),
    "another byte order": lambda: POINTS.astype(">f8"),
    "columns first in memory": lambda: np.asfortranarray(POINTS),
    "long doubles": lambda: POINTS.astype(np.longdouble),
}


@pytest.mark.parametrize("kind", TAKEN)
def test_what_is_a_cloud_is_taken(kind):
    expected = clean(POINTS, FAST)
    np.testing.assert_array_equal(clean(TAKEN[kind](), FAST).labels, expected.labels)


def test_a_table_of_x_y_and_z_is_taken():
    pytest.importorskip("pandas", reason="pandas is not installed")
    np.testing.assert_array_equal(
        clean(table(["x", "y", "z"]), FAST).labels, clean(POINTS, FAST).labels
    )


def test_what_is_masked_is_invalid():
    masked = np.ma.masked_array(POINTS, mask=np.zeros(POINTS.shape, bool))
    masked[7, 1] = np.ma.masked
    assert np.flatnonzero(clean(masked, FAST).labels == dynahull.Label.INVALID).tolist() == [7]


@pytest.mark.parametrize(
    ("parameters", "more", "message"),
    [
        ("nothing", {}, "indoor.*found 'nothing'"),
        (5, {}, "of type int"),
        ([("neighbours", 5)], {}, "of type list"),
        ({"neighbours": 5}, {}, "neighbours"),
        (None, {"threads": 0}, "threads"),
        (None, {"threads": "2"}, "threads"),
        (None, {"observer": 5}, "observer"),
        (None, {"removal": None}, "removal"),
        (None, {"max_height": "high"}, "max_height"),
    ],
)
def test_wrong_parameters_are_one_line(parameters, more, message):
    with pytest.raises(InvalidParametersError, match=message) as refused:
        clean(POINTS, parameters, **more)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("mask", [[1, 0], np.zeros(300), "no", [[True]] * 300])
def test_a_mask_that_is_none_is_refused(mask):
    with pytest.raises(InvalidPointsError, match="left_out: expected"):
        clean(POINTS, left_out=mask)


def test_random_states_that_are_none_are_refused():
    with pytest.raises(InvalidParametersError, match="random_state"):
        DynaHull(random_state="yesterday").fit(POINTS)


@pytest.mark.parametrize("name", READY)
def test_ready_parameters_are_those_of_the_ready_configurations(name):
    assert MethodParameters.chosen(name, {}) == load_configuration(name).method()
    mixed = MethodParameters.chosen(name, {"neighbours": {"k": 9}})
    assert mixed.neighbours.k == 9
    assert mixed.ground == load_configuration(name).ground


def test_every_ready_configuration_of_the_method_has_its_name():
    names = {
        name
        for name in ready_configurations()
        if load_configuration(name).execution.cluster == "local"
    }
    assert names == set(READY)


def test_a_configuration_of_the_product_is_taken_with_sections_in_place_of_its_own():
    given = load_configuration("indoor")
    assert MethodParameters.chosen(given, {"neighbours": {"k": 9}}).max_height == 2.5


def test_the_package_shows_what_it_has():
    assert {"clean", "DynaHull", "Label", "InvalidPointsError"} <= set(dir(dynahull))


@pytest.mark.parametrize(
    "scan", [[0, 1], np.zeros(len(POINTS)), np.full(len(POINTS), -2), np.full(len(POINTS), 2**31)]
)
def test_scan_numbers_that_are_none_are_refused(scan):
    with pytest.raises(InvalidPointsError, match="scan: expected"):
        clean(POINTS, scan=scan)


def test_scan_numbers_are_taken():
    scan = np.arange(len(POINTS)) - 1
    assert len(clean(POINTS, "auto", scan=scan).labels) == len(POINTS)
    assert len(DynaHull(configuration="auto").fit_predict(POINTS, scan=scan)) == len(POINTS)
    with pytest.raises(InvalidPointsError, match="scan: expected"):
        DynaHull(configuration="auto").fit(POINTS, scan=scan[1:])
