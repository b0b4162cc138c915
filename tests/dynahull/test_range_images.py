"""Range images, and how many scans saw through a place."""

import itertools

import laspy
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynahull import clean
from dynahull.errors import InvalidPointsError
from dynahull.evidence import viewpoints
from dynahull.evidence.range_images import (
    CLEARLY,
    FACE,
    MET,
    NOTHING,
    PIXELS,
    RETURN_BYTES,
    THROUGH,
    Returns,
    Views,
)
from dynahull.evidence.viewpoints import Viewpoints, count_coordinates
from dynahull.evidence.voxels import cells_of

FACES = [(axis, sign) for axis in range(3) for sign in (1, -1)]


def views_of(xyz, scan, sensor):
    return Views(sensor, Returns.of(xyz, scan, sensor).images)


def pixel_of(direction):
    """Return face, row and column of a direction, as plainly as can be."""
    axis = int(np.argmax(np.abs(direction)))
    face = FACES.index((axis, int(np.sign(direction[axis]))))
    others = [direction[other] / abs(direction[axis]) for other in range(3) if other != axis]
    column, row = (min(int((share + 1) * (FACE / 2)), FACE - 1) for share in others)
    return face, row, column


def counted(xyz, scan, sensor, place):
    """Count one place, as plainly as can be."""
    counts = [0, 0, 0]
    for number, origin in enumerate(sensor):
        away = np.linalg.norm(place - origin)
        if not 0.3 <= away <= 40:
            continue
        face, row, column = pixel_of(place - origin)
        own, around = [], []
        for point in xyz[scan == number]:
            distance = np.linalg.norm(point - origin)
            if distance < 0.3:
                continue
            a, b, c = pixel_of(point - origin)
            if a == face and abs(b - row) <= 1 and abs(c - column) <= 1:
                around.append(np.floor(distance * 100))
                if (b, c) == (row, column):
                    own.append(np.floor(distance * 100))
        margin = 20 + away
        if own:
            counts[THROUGH] += min(own) > 100 * away + margin
            counts[MET] += abs(min(own) - 100 * away) <= margin
        counts[CLEARLY] += bool(around) and min(around) > 100 * away + margin
    return counts


def recorded(seed, count=400, scans=5):
    """Return points about a sensor that moves, their scans, and its places."""
    random = np.random.default_rng(seed)
    sensor = random.uniform(-3, 3, (scans, 3))
    xyz = random.normal(size=(count, 3)) * random.choice([0.5, 3, 20], (count, 1))
    return xyz, random.integers(-1, scans, count).astype(np.int32), sensor


@settings(deadline=None, max_examples=15)
@given(seed=st.integers(0, 2**32 - 1))
def test_counts_are_those_of_the_plain_version(seed):
    xyz, scan, sensor = recorded(seed)
    cells = np.unique(cells_of(xyz[::8], 0.5), axis=0)
    found = views_of(xyz, scan, sensor).count(cells, 0.5)
    plain = [counted(xyz, scan, sensor, (cell + 0.5) * 0.5) for cell in cells]
    assert found.tolist() == plain


def drawn(xyz, scan, sensor):
    """Draw the range images of all scans, as plainly as can be."""
    images = np.full((len(sensor), 6, FACE, FACE), NOTHING, np.uint16)
    for point, number in zip(xyz, scan, strict=True):
        distance = np.linalg.norm(point - sensor[number])
        if number >= 0 and distance >= 0.3:
            pixel = number, *pixel_of(point - sensor[number])
            images[pixel] = min(images[pixel], int(distance * 100))
    return images.reshape(-1, PIXELS)


@settings(deadline=None, max_examples=20)
@given(seed=st.integers(0, 2**32 - 1), parts=st.integers(1, 7))
def test_images_are_those_of_parts_in_any_order_and_counts_those_of_any_cells(seed, parts):
    xyz, scan, sensor = recorded(seed)
    returns = Returns.of(xyz, scan, sensor)
    whole = returns.images(np.arange(len(sensor)))
    assert (whole == drawn(xyz, scan, sensor)).all()
    order = np.random.default_rng(seed).permutation(len(xyz))
    pieces = [Returns.of(xyz[own], scan[own], sensor) for own in np.array_split(order, parts)]
    joined = Returns.joined(pieces)
    assert (joined.images(np.array([3, 1])) == whole[[3, 1]]).all()
    assert (joined.images(np.arange(len(sensor))) == whole).all()
    cells = cells_of(xyz, 0.2)
    counts = Views(sensor, joined.images).count(cells, 0.2, threads=2)
    views = Views(sensor, returns.images)
    assert (counts == views.count(cells, 0.2)).all()
    assert (counts[::3] == views.count(cells[::3], 0.2)).all()


def test_returns_are_kept_small():
    xyz, scan, sensor = recorded(0)
    returns = Returns.of(np.repeat(xyz, 9, axis=0), np.repeat(scan, 9), sensor)
    assert returns.returns.itemsize == RETURN_BYTES
    assert returns.counts.sum() == len(returns.returns) <= (scan >= 0).sum()
    images = returns.images(np.arange(len(sensor)))
    assert returns.counts.tolist() == (images != NOTHING).sum(axis=1).tolist()
    assert not len(Returns.of(xyz, np.full(len(xyz), -1, np.int32), sensor).returns)


def room_with_a_visitor(scans=12):
    """Return a wall that all scans see, and a body before it that one scan sees instead."""
    y, z = np.meshgrid(np.arange(-3, 3, 0.04), np.arange(-1, 1.5, 0.04))
    wall = np.column_stack([np.full(y.size, 6.0), y.ravel(), z.ravel()])
    body = wall[(np.abs(wall[:, 1]) < 0.6) & (np.abs(wall[:, 2]) < 0.6)] * [0.5, 0.5, 0.5]
    hidden = (np.abs(wall[:, 1]) < 0.65) & (np.abs(wall[:, 2]) < 0.65)
    seen = [wall[~hidden] if number == 4 else wall for number in range(scans)] + [body]
    scan = np.repeat([*range(scans), 4], [len(each) for each in seen]).astype(np.int32)
    sensor = np.column_stack([np.linspace(0, 0.05, scans), np.zeros(scans), np.zeros(scans)])
    return np.concatenate(seen), scan, sensor, body


def test_a_body_that_stood_there_for_a_scan_is_seen_through_and_a_wall_is_not():
    xyz, scan, sensor, body = room_with_a_visitor()
    views = views_of(xyz, scan, sensor)
    of_body = views.count(np.unique(cells_of(body, 0.1), axis=0), 0.1)
    assert (of_body[:, THROUGH] == 11).all()
    assert (of_body[:, MET] == 1).mean() > 0.8
    assert (of_body[:, CLEARLY] == 11).all()
    wall = xyz[scan == 0]
    of_wall = views.count(np.unique(cells_of(wall, 0.1), axis=0), 0.1)
    assert of_wall[:, [THROUGH, CLEARLY]].sum() == 0
    assert np.median(of_wall[:, MET]) == 12


@pytest.mark.parametrize(
    ("poses", "scan", "message"),
    [
        (np.zeros((5, 2)), [0, 1], r"expected numbers of shape .* found shape \(5, 2\)"),
        (np.zeros((1, 3)), [0, 1], "expected one for each scan number up to 1, found 1"),
        (np.zeros((2, 3)), None, "expected scan as well"),
    ],
)
def test_poses_that_do_not_fit_are_refused(poses, scan, message):
    with pytest.raises(InvalidPointsError, match=f"poses: {message}"):
        clean(np.zeros((2, 3)), scan=scan, poses=poses)


@settings(deadline=None, max_examples=20)
@given(seed=st.integers(0, 2**32 - 1), parts=st.integers(1, 5), most=st.sampled_from([2, 7, 99]))
def test_viewpoints_are_medians_and_those_of_parts_together(seed, parts, most):
    random = np.random.default_rng(seed)
    count = int(random.integers(0, 900))
    xyz = random.normal(size=(count, 3)) * 30
    xyz[::11] = [np.nan, 1e200, 0]
    scan = random.choice([-1, 3, 4, 90, 1_000_000], count).astype(np.int32)
    bounds = np.linspace(0, count, parts + 1).astype(int)
    counts = [
        count_coordinates(xyz[begin:end], scan[begin:end], begin)
        for begin, end in itertools.pairwise(bounds)
    ]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(viewpoints, "MOST_VIEWPOINTS", most)
        counts_of_all = count_coordinates(xyz, scan, 0)
        whole = Viewpoints.of_counts(lambda: [counts_of_all])
        patch.setattr(viewpoints, "_SCANS_AT_A_TIME", 2)
        found = Viewpoints.of_counts(lambda: counts[::-1])
    assert found.places.tobytes() == whole.places.tobytes()
    assert len(found.numbers) <= most
    looked_at = np.arange(count) % 7 == 0
    looked_at &= np.isfinite(xyz).all(axis=1) & (np.abs(xyz) < 1e9).all(axis=1)
    for number, place in zip(found.numbers, found.places, strict=True):
        own = np.sort(xyz[looked_at & (scan == number)], axis=0)
        median = own[(len(own) - 1) // 2]
        np.testing.assert_allclose(place, median + [0, 0, 1], atol=0.2501)
    rows = found.rows(scan)
    assert (rows[scan < 0] == -1).all()
    known = rows >= 0
    assert (found.numbers[rows[known]] <= scan[known]).all()


def test_poses_place_each_scan():
    sensor = np.arange(12.0).reshape(4, 3)
    told = Viewpoints.of_poses(sensor)
    assert told.rows(np.array([3, -1, 0], np.int32)).tolist() == [3, -1, 0]
    assert told.are_told and (told.places == sensor).all()


@pytest.mark.parametrize("wrong", ["mixed", "elsewhere", "thinned"])
def test_wrong_scans_and_poses_cost_no_walls(shared_data, wrong):
    """As of a map whose scan numbers say something else, or that a voxel filter thinned."""
    file = laspy.read(shared_data / "maps/semantickitti_04.laz")
    near = np.abs(np.asarray(file.xyz)[:, :2] - [15, 5]).max(axis=1) < 15
    xyz = np.ascontiguousarray(file.xyz[near])
    scan = np.asarray(file.point_source_id).astype(np.int32)[near]
    still = np.asarray(file.user_data)[near] == 1
    poses = None
    if wrong == "mixed":
        scan = np.random.default_rng(0).permutation(scan)
    elif wrong == "elsewhere":
        poses = np.tile([30.0, -20.0, 3.0], (10, 1))
    else:
        kept = np.sort(np.unique(cells_of(xyz, 0.1), axis=0, return_index=True)[1])
        xyz, scan, still = xyz[kept], scan[kept], still[kept]
    result = clean(xyz, "auto", scan=scan, poses=poses)
    assert still.sum() > 10_000
    assert (still & ~result.kept).sum() < 0.005 * still.sum()
