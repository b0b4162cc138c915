"""What PDAL's filters.python calls; PDAL itself gives and takes dictionaries of arrays."""

import json
import re
from importlib import import_module
from pathlib import Path

import numpy as np

from dynahull import Label, clean
from dynahull.pdal import mark_ghosts, remove_ghosts


def room():
    random = np.random.default_rng(1)
    floor = random.uniform(size=(6000, 3)) * [8, 6, 0.01]
    wall = random.uniform(size=(4000, 3)) * [8, 0.01, 2.5]
    walker = random.uniform(size=(300, 3)) * [6, 0.4, 1.7] + [1, 3, 0.1]
    xyz = np.concatenate([floor, wall, walker])
    classes = np.full(len(xyz), 1, np.uint8)
    classes[:50] = 7
    return {**dict(zip("XYZ", xyz.T, strict=True)), "Classification": classes}


def test_the_stream_is_that_of_clean():
    ins, outs = room(), {}
    xyz = np.column_stack([ins[axis] for axis in "XYZ"])
    expected = clean(xyz, "auto", left_out=ins["Classification"] == 7)
    assert remove_ghosts(ins, outs) is True
    np.testing.assert_array_equal(outs["Mask"], expected.kept)
    assert outs["Mask"].dtype == bool
    before = ins["Classification"].copy()
    assert mark_ghosts(ins, outs) is True
    gone = expected.labels == Label.DYNAMIC
    np.testing.assert_array_equal(outs["Classification"], np.where(gone, 7, before))
    np.testing.assert_array_equal(ins["Classification"], before)


def test_the_pipeline_on_the_page_calls_a_function_that_there_is():
    page = Path(__file__).resolve().parents[2] / "docs/ecosystem.md"
    pipeline = json.loads(re.search(r"```json\n(.*?)```", page.read_text(), re.DOTALL)[1])
    (stage,) = (each for each in pipeline if isinstance(each, dict) and "source" in each)
    module = re.fullmatch(r"from (\S+) import (\w+)", stage["source"])
    assert module[2] == stage["function"]
    assert callable(getattr(import_module(module[1]), module[2]))
