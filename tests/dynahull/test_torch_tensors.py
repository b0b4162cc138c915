"""Tensors of PyTorch are taken as the arrays that they are, and given back as tensors."""

import numpy as np
import pytest

from dynahull import DynaHull, InvalidPointsError, clean

PARAMETERS = {"ground": {"method": "none"}, "neighbours": {"k": 20}}


@pytest.fixture(scope="module")
def torch():
    return pytest.importorskip("torch", reason="PyTorch is not installed", exc_type=ImportError)


@pytest.fixture(scope="module")
def points():
    return np.random.default_rng(0).uniform(size=(400, 3)) * [4, 0.5, 2]


MADE = {
    "as it is": lambda tensor: tensor,
    "one that learns": lambda tensor: tensor.clone().requires_grad_(),
    "columns first": lambda tensor: tensor.T.contiguous().T,
    "every second row": lambda tensor: tensor.repeat_interleave(2, dim=0)[::2],
}


@pytest.mark.parametrize("kind", ["float16", "float32", "float64"])
@pytest.mark.parametrize("how", MADE)
def test_a_tensor_is_cleaned_as_its_array_is(torch, points, kind, how):
    tensor = MADE[how](torch.from_numpy(points.astype(kind)))
    result, expected = clean(tensor, PARAMETERS), clean(points.astype(kind), PARAMETERS)
    np.testing.assert_array_equal(result.labels, expected.labels)
    np.testing.assert_array_equal(result.density, expected.density)
    cleaned = result.cleaned(tensor)
    assert isinstance(cleaned, torch.Tensor)
    assert 0 < len(cleaned) < len(tensor)
    np.testing.assert_array_equal(cleaned.detach().numpy(), points.astype(kind)[expected.kept])


def test_what_goes_with_the_points_may_be_tensors_too(torch, points):
    rows = np.arange(len(points))
    beside = {
        "classification": (rows % 4).astype(np.uint8),
        "protected": rows % 3 == 0,
        "scan": (rows // 40).astype(np.int64),
    }
    given = {name: torch.from_numpy(values) for name, values in beside.items()}
    configuration = {"removal": {"decision": "auto", "confidence": 0.05}, **PARAMETERS}
    result = clean(torch.from_numpy(points), configuration, **given)
    expected = clean(points, configuration, **beside)
    np.testing.assert_array_equal(result.labels, expected.labels)
    np.testing.assert_array_equal(result.score, expected.score)


def test_the_estimator_takes_tensors(torch, points):
    labels = DynaHull(k=20, ground="none").fit_predict(torch.from_numpy(points))
    np.testing.assert_array_equal(labels, DynaHull(k=20, ground="none").fit_predict(points))


def test_what_numpy_has_no_numbers_for_is_refused_in_one_line(torch, points):
    for tensor in (
        torch.from_numpy(points).to(torch.bfloat16),
        torch.from_numpy(points).to_sparse(),
        torch.empty((400, 3), device="meta"),
    ):
        with pytest.raises(InvalidPointsError, match=r"^points: expected "):
            clean(tensor, PARAMETERS)
