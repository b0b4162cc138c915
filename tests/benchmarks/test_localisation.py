"""Localisation: matching on a map whose answer is known, and the errors of trajectories."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(autouse=True)
def _benchmarks_are_importable(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT))


def poses_along(x):
    poses = np.tile(np.eye(4), (len(x), 1, 1))
    poses[:, 0, 3] = x
    return poses


def test_errors_are_those_of_the_poses():
    pytest.importorskip("evo")
    from benchmarks.localisation.trajectories import errors_of  # noqa: PLC0415

    truth = poses_along(np.arange(0, 10, 0.5))
    beside = truth.copy()
    beside[:, 1, 3] += 0.03
    errors = errors_of(beside, truth)
    assert [errors.ape_rmse, errors.ape_largest] == pytest.approx([30, 30])
    assert errors.rpe_rmse == pytest.approx(0, abs=1e-6) and errors.lost_percent == 0
    too_long = poses_along(1.02 * truth[:, 0, 3])
    assert errors_of(too_long, truth).rpe_rmse == pytest.approx(20)
    beside[-5:, 1, 3] += 1
    assert errors_of(beside, truth).lost_percent == 25


def test_scans_are_found_where_they_were_taken():
    pytest.importorskip("small_gicp")
    from benchmarks.localisation.matching import localise  # noqa: PLC0415

    random = np.random.default_rng(0)
    room = random.uniform([0, 0, 0], [9, 6, 3], (60_000, 3))
    side = random.integers(0, 3, len(room))
    far = random.random(len(room)) < 0.5
    room[np.arange(len(room)), side] = np.array([9.0, 6.0, 3.0])[side] * far  # on six walls
    truth = poses_along(np.linspace(2, 4, 9))
    truth[:, 1:3, 3] = [3, 1]
    scans = [random.permutation(room)[:8_000] - pose[:3, 3] for pose in truth]
    moves = np.linalg.inv(truth[:-1]) @ truth[1:]
    moves[:, 1, 3] += 0.05  # what the wheels tell is wrong by a fifth, and sideways
    found = localise(room, scans, moves, truth[0])
    assert np.abs(found - truth).max() < 0.02


def test_odometry_is_wrong_by_a_share_of_the_motion():
    from benchmarks.localisation.maps import SLIP, TURN_ERROR, odometry  # noqa: PLC0415

    still, on, turn = (np.eye(4) for _ in range(3))
    on[0, 3] = 2.0
    turn[:3, :3] = Rotation.from_rotvec([0, 0, 0.5]).as_matrix()
    moves = np.repeat([still, on, turn], 2000, axis=0)
    told = odometry(moves, np.random.default_rng(0))
    assert told[:2000] == pytest.approx(moves[:2000], abs=1e-12)
    assert told[2000:4000, 0, 3].std() == pytest.approx(2 * SLIP, rel=0.1)
    turned = Rotation.from_matrix(told[4000:, :3, :3]).as_rotvec()[:, 2]
    assert turned.std() == pytest.approx(0.5 * TURN_ERROR, rel=0.1)


def test_a_table_tells_means_and_extremes():
    from benchmarks.localisation.__main__ import table  # noqa: PLC0415
    from benchmarks.localisation.trajectories import Errors  # noqa: PLC0415

    seeds = [Errors(10, 20, 1, 2, 0), Errors(30, 40, 3, 4, 0)]
    rows = table({"true map": seeds, "not cleaned": seeds[:1]}).splitlines()
    assert rows[-2].startswith("| true map | 20.00 (10.00 to 30.00) | 30.00 (20.00 to 40.00) |")
    assert rows[-1] == "| not cleaned | 10.00 | 20.00 | 2.00 | 1.00 | 0.00 |"
