"""What PDAL's filters.python calls, with dictionaries of arrays, and by PDAL where it is there."""

import json
import re
import shlex
import shutil
import subprocess
from importlib import import_module
from pathlib import Path

import laspy
import numpy as np
import pytest

from dynahull import Label, clean
from dynahull.pdal import mark_ghosts, remove_ghosts

PAGE = Path(__file__).resolve().parents[2] / "docs/ecosystem.md"


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


def page_pipeline():
    return json.loads(re.search(r"```json\n(.*?)```", PAGE.read_text(), re.DOTALL)[1])


def test_the_pipeline_on_the_page_calls_a_function_that_there_is():
    (stage,) = (each for each in page_pipeline() if isinstance(each, dict) and "source" in each)
    module = re.fullmatch(r"from (\S+) import (\w+)", stage["source"])
    assert module[2] == stage["function"]
    assert callable(getattr(import_module(module[1]), module[2]))


@pytest.fixture(scope="module")
def pdal():
    """PDAL, which Debian has left out since its release 12."""
    program = shutil.which("pdal")
    if program is None:
        pytest.skip("PDAL is not installed")
    return program


@pytest.fixture
def las_map(tmp_path):
    ins = room()
    points = laspy.LasData(laspy.LasHeader(version="1.4", point_format=6))
    points.header.scales = [1e-4] * 3
    points.xyz = np.column_stack([ins[axis] for axis in "XYZ"])
    points.classification = ins["Classification"]
    points.write(tmp_path / "map.las")
    return laspy.read(tmp_path / "map.las")


@pytest.mark.parametrize("function", ["remove_ghosts", "mark_ghosts"])
def test_pdal_runs_the_pipeline_on_the_page(pdal, las_map, tmp_path, function):
    drivers = subprocess.run([pdal, "--drivers"], check=True, capture_output=True, text=True)
    if "filters.python" not in drivers.stdout:
        pytest.skip("PDAL has no filters.python")
    pipeline = json.dumps(page_pipeline()).replace(".laz", ".las")  # its LAZ is an option of PDAL's
    (tmp_path / "pipeline.json").write_text(pipeline.replace("remove_ghosts", function))
    subprocess.run([pdal, "pipeline", "pipeline.json"], check=True, cwd=tmp_path)
    noise = las_map.classification == 7
    expected = clean(np.asarray(las_map.xyz), "auto", left_out=noise)
    gone = expected.labels == Label.DYNAMIC
    assert gone.any()
    found = laspy.read(tmp_path / "cleaned.las")
    if function == "remove_ghosts":
        assert len(found) == np.count_nonzero(expected.kept)
    else:
        np.testing.assert_array_equal(found.classification == 7, noise | gone)
    unmoved = slice(None) if function == "mark_ghosts" else expected.kept
    np.testing.assert_allclose(found.xyz, las_map.xyz[unmoved], atol=0.006)  # PDAL's LAS: cm


def test_a_run_between_two_pdal_steps(pdal, las_map, tmp_path):
    las_map.write(tmp_path / "raw.las")
    block = re.search(r"```console\n(\$ pdal .*?)```", PAGE.read_text(), re.DOTALL)[1]
    commands = block.replace("$ ", "").replace(".laz", ".las").splitlines()
    for command in commands:
        subprocess.run(shlex.split(command), check=True, cwd=tmp_path)
    labelled = laspy.read(tmp_path / "labelled/labelled.las")
    noise = labelled.classification == 7
    assert 0 < np.count_nonzero(noise) < len(labelled)
    cleaned = laspy.read(tmp_path / "cleaned.las")
    np.testing.assert_allclose(cleaned.xyz, labelled.xyz[~noise], atol=0.006)
