"""Labels: which values mean what, and where they are read from."""

import laspy
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from pipeline.errors import ConfigurationError, EvaluationError
from pipeline.evaluation.truth import (
    is_label_table,
    parse_values,
    read_label_table,
    read_labels_of_map,
    to_truth,
)
from tiling.collection import MapCollection

MOVED = (range(1, 2),)


def test_values_and_ranges():
    assert parse_values("--dynamic", "2") == (range(2, 3),)
    assert parse_values("--dynamic", "-1, 252-259") == (range(-1, 0), range(252, 260))
    assert parse_values("--unlabelled", "") == ()


@pytest.mark.parametrize("text", ["a", "1,", "1.5", "2-", "259-252", "1 2"])
def test_other_values_are_refused_in_one_line(text):
    with pytest.raises(ConfigurationError, match=f"--dynamic {text}: "):
        parse_values("--dynamic", text)


def test_all_that_is_neither_dynamic_nor_unlabelled_is_static():
    values = np.array([0, 1, 2, 3, 40], dtype=np.uint8)
    truth = to_truth(values, (range(2, 4),), (range(0, 1),))
    assert truth.tolist() == [2, 0, 1, 1, 0]


def test_semantic_kitti_keeps_the_instance_above_the_class():
    values = np.array([252, 252 + (7 << 16), 40 + (252 << 16), 259], dtype=np.uint32)
    moving = parse_values("--dynamic", "252-259")
    assert to_truth(values, moving, ()).tolist() == [1, 1, 0, 1]
    # ERASOR and the DynamicMap benchmark keep them in a float.
    assert to_truth(values.astype(np.float32), moving, ()).tolist() == [1, 1, 0, 1]


def test_what_is_no_whole_number_is_not_labelled():
    assert to_truth(np.array([0, 1, np.nan, np.inf, 0.5]), MOVED, ()).tolist() == [0, 1, 2, 2, 2]
    assert to_truth(np.array([-1, 1]), MOVED, (range(-1, 0),)).tolist() == [2, 1]
    assert to_truth(np.array([False, True]), MOVED, ()).tolist() == [0, 1]


def test_a_table_of_labels(tmp_path):
    path = tmp_path / "truth.parquet"
    pq.write_table(pa.table({"moving": [True, False, None], "kind": ["a", "b", "c"]}), path)
    assert is_label_table(path)
    assert not is_label_table(tmp_path / "other.parquet")
    with pytest.raises(EvaluationError, match=r"expected a column 'x' .*, found moving, kind"):
        read_label_table(path, "x", MOVED, ())
    with pytest.raises(EvaluationError, match="expected numbers in 'kind'"):
        read_label_table(path, "kind", MOVED, ())
    pq.write_table(pa.table({"moving": [True, False, False]}), path)
    labels = read_label_table(path, None, MOVED, ())
    assert [each.tolist() for each in labels] == [each.tolist() for each in labels] == [[1, 0, 0]]
    pq.write_table(pa.table({"moving": [True, None, False]}), path)
    with pytest.raises(EvaluationError, match="expected numbers in 'moving', found missing values"):
        read_label_table(path, None, MOVED, ())


def test_a_table_with_coordinates_is_a_map(tmp_path):
    path = tmp_path / "map.parquet"
    pq.write_table(pa.table({"x": [0.0], "y": [0.0], "z": [0.0], "moving": [True]}), path)
    assert not is_label_table(path)
    path.write_bytes(b"something else")
    assert not is_label_table(path)


def test_labels_of_a_map_in_several_files(tmp_path):
    for name, labels in (("a.las", [0, 1, 2]), ("b.laz", [2, 2])):
        cloud = laspy.create(point_format=6, file_version="1.4")
        cloud.xyz = np.arange(3.0 * len(labels)).reshape(-1, 3)
        cloud.user_data = np.array(labels, dtype=np.uint8)
        cloud.write(tmp_path / name)
    collection = MapCollection([tmp_path / "a.las", tmp_path / "b.laz"])
    truth = read_labels_of_map(collection, "user_data", (range(2, 3),), (range(0, 1),))
    assert [each.tolist() for each in truth] == [[2, 0, 1], [1, 1]]
