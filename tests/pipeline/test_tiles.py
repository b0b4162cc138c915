"""A map cut into tiles is cleaned as in memory: labels, clusters, densities, bit for bit."""

import json
import tempfile
from collections import Counter
from pathlib import Path

import laspy
import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from dynahull import Label, clean
from dynahull.ground.reach import ground_radius, height_radius
from pipeline.configuration.run import load_configuration
from pipeline.metres import open_collection
from pipeline.places import DecisionSums
from pipeline.progress import LogDisplay, StageObserver
from pipeline.run import run
from pipeline.scan_numbers import find_scans
from tiling.collection import MapCollection
from tiling.errors import GridError

FAST = [
    "neighbours.k=8",
    "clustering.count=3",
    "execution.cluster=none",
    "output.labels=true",
    "removal.decision=paper",
]
SMALL_GROUND = [
    "ground.slope.window=0.3",
    "ground.slope.expert.extension=0.3",
    "ground.slope.expert.storey_radius=0.5",
]
"""A slope ground that looks about two metres far, so that maps of a few metres have borders."""


pytestmark = pytest.mark.usefixtures("nothing_waits_for_the_disk")


def cleaned(maps, folder, *wanted):
    configuration = load_configuration(None, [*FAST, *wanted])
    return run(maps, folder, configuration, StageObserver(LogDisplay()))


def tiled(maps, folder, max_points, *wanted):
    """Clean over tiles, and return the report, the labels table, and the chunk files."""
    wanted = [*wanted, f"tiling.max_points={max_points}", "output.keep_work=true"]
    report = cleaned(maps, folder, *wanted)
    chunks = sorted((folder / ".dynahull-work/tiles/chunks").iterdir())
    return report, pq.read_table(folder / "labels.parquet"), chunks


def in_memory(maps, *wanted):
    """What `dynahull.clean` says of the coordinates, and scans, that the files hold."""
    configuration = load_configuration(None, [*FAST, *wanted])
    collection = open_collection([Path(path) for path in maps], configuration.input)
    numbered = list(collection.batches())
    batches = [batch for _, batch in numbered]
    xyz = np.concatenate([np.empty((0, 3)), *(batch.xyz for batch in batches)])
    classes, scan, poses = None, None, None
    if collection.has_classification:
        classes = np.concatenate([batch.classification for batch in batches])
    source = find_scans(collection, configuration)
    if source is not None:
        scan = np.concatenate([source.numbers(collection, *each) for each in numbered])
        poses = source.sensor(collection)
    return clean(xyz, configuration.method(), classification=classes, scan=scan, poses=poses)


def assert_same(table, result):
    """Compare to the last bit: NaN equals NaN, and nothing is close enough."""
    titles = np.array([label.title for label in Label])
    assert table["label"].to_pylist() == titles[result.labels].tolist()
    assert table["cluster"].to_numpy().tobytes() == result.cluster.tobytes()
    assert table["density"].to_numpy().tobytes() == result.density.tobytes()
    assert table["score"].to_numpy().tobytes() == result.score.tobytes()


def assert_same_tables(one, other):
    for name in ("label", "cluster", "density", "score"):
        np.testing.assert_array_equal(one[name].to_numpy(), other[name].to_numpy())


def room(count, random):
    """A floor, two walls, and something that moved."""
    return np.concatenate(
        [
            random.uniform(size=(count, 3)) * [9, 7, 0.02],
            random.uniform(size=(count // 3, 3)) * [9, 0.02, 2.5],
            random.uniform(size=(count // 3, 3)) * [0.02, 7, 2.5] + [9, 0, 0],
            random.uniform(size=(count // 10, 3)) * [3, 2, 1.6] + [2, 3, 0.3],
        ]
    )


def turned(points):
    """Turn about the vertical by an odd angle, and move by a million metres."""
    cosine, sine = np.cos(0.7321), np.sin(0.7321)
    turn = np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])
    return points @ turn.T + [1e6, -1e6, 1e6]


def spoilt(points):
    """Put in coordinates that cannot be measured."""
    points = points.copy()
    bad = [[np.nan, 0, 0], [0, np.inf, 0], [0, 0, -np.inf], [1e200, 1, 1], [1, 1, -1e200]]
    points[:: max(len(points) // 5, 1)][:5] = bad[: len(points[:: max(len(points) // 5, 1)][:5])]
    return points


KINDS = {
    "scattered": lambda points, _: points,
    "gridded": lambda points, _: np.round(points * 16) / 16,
    "duplicates": lambda points, random: (
        np.round(points[random.integers(0, max(len(points) // 6, 1), len(points))] * 4) / 4
    ),
    "utm": lambda points, _: points + [652_345.5, 5_401_234.25, 431.125],
    "turned": lambda points, _: turned(points),
    "spoilt": lambda points, _: spoilt(points),
}


def poses_of(points, folder, random):
    """Write poses of 40 scans among the points, and return the file."""
    poses = np.tile(np.eye(4)[:3], (40, 1, 1))
    inside = points[np.isfinite(points).all(axis=1) & (np.abs(points) < 1e7).all(axis=1)]
    poses[:, :, 3] = inside[random.integers(0, len(inside), 40)] + random.normal(size=(40, 3))
    np.savetxt(folder / "poses.txt", poses.reshape(40, 12), "%.17g")
    return folder / "poses.txt"


@settings(deadline=None, max_examples=24, suppress_health_check=[HealthCheck.too_slow])
@given(
    kind=st.sampled_from(sorted(KINDS)),
    seed=st.integers(0, 2**32 - 1),
    count=st.integers(20, 420),
    max_points=st.sampled_from([7, 60, 150, 400]),
    halo=st.sampled_from(["0", "0.05", "0.3", "3", "auto"]),
    ground=st.sampled_from(["none", "slope", "slope and height"]),
    cell=st.sampled_from([0.25, 0.3, 0.5, 1.0]),
    decision=st.sampled_from(["rank", "stepped", "auto"]),
    decoded=st.booleans(),
    told=st.sampled_from(["nothing", "scans", "scans and poses"]),
)
def test_labels_clusters_and_densities_are_those_of_the_whole_map(
    kind, seed, count, max_points, halo, ground, cell, decision, decoded, told
):
    random = np.random.default_rng(seed)
    points = KINDS[kind](random.permutation(room(count, random)), random)
    max_points = max(max_points, len(points) // 12)  # a dozen tiles or two show all there is
    wanted = [
        f"ground.method={ground.split()[0]}",
        f"max_height={'1.2' if 'height' in ground else 'null'}",
        "removal.decision=auto" if decision == "auto" else f"removal.threshold={decision}",
        "removal.confidence=0.2",
        f"ground.slope.expert.cell={cell}",
        *SMALL_GROUND,
    ]
    with tempfile.TemporaryDirectory() as folder:
        # Of a map that must be decoded, coordinates are kept from the survey on.
        name, save = ("map.npz", np.savez_compressed) if decoded else ("map.npy", np.save)
        maps = [Path(folder) / (name if told == "nothing" else "map.npz")]
        if told != "nothing":
            scan = random.integers(0, 40, len(points)).astype(np.uint16)
            np.savez_compressed(maps[0], points=points, scan=scan)
            if told == "scans and poses":
                wanted.append(f"input.poses={poses_of(points, Path(folder), random)}")
        else:
            save(maps[0], points)
        report, table, chunks = tiled(
            maps, Path(folder) / "out", min(max_points, len(points) // 2),
            f"tiling.halo={halo}", *wanted,
        )  # fmt: skip
        assert len(chunks) > 1 or kind == "duplicates"
        result = in_memory(maps, *wanted)
        assert_same(table, result)
        sums = DecisionSums.by_density(points[result.labels == Label.DYNAMIC])
        if decision == "auto":
            sums = DecisionSums.of(points, result.score, result.reason, 0.2)
            assert report.uncertain_points == sums.decision().uncertain
        decided = sums.decision()
        assert report.places == list(decided.places)
        assert report.place_count == decided.place_count
        assert report.scattered_points == decided.scattered


@pytest.fixture
def room_file(tmp_path):
    random = np.random.default_rng(5)
    np.save(tmp_path / "room.npy", random.permutation(room(500, random)))
    return tmp_path / "room.npy"


def test_a_halo_narrower_than_the_ground_looks_is_made_up_for(room_file, tmp_path):
    wanted = ["max_height=1.2", *SMALL_GROUND]
    configuration = load_configuration(None, wanted)
    assert ground_radius(configuration.ground) + height_radius(configuration.ground) > 1
    result = in_memory([room_file], *wanted)
    assert (result.labels == Label.GROUND).sum() > 100  # what a border could hide is there
    for halo in ("0", "0.5"):
        _, table, chunks = tiled([room_file], tmp_path / halo, 120, f"tiling.halo={halo}", *wanted)
        assert len(chunks) > 5
        assert_same(table, result)


@pytest.mark.parametrize("decision", ["paper", "auto"])
def test_hundreds_of_tiles_of_a_room_are_the_room(decision, room_file, tmp_path):
    wanted = ["max_height=1.2", f"removal.decision={decision}", *SMALL_GROUND]
    _, table, chunks = tiled([room_file], tmp_path / "out", 4, "tiling.halo=0.05", *wanted)
    assert len(chunks) > 200
    assert_same(table, in_memory([room_file], *wanted))
    for spent in ("cut", "columns", "free", "sample", "spread"):  # what is needed no more is gone
        kept = (tmp_path / "out/.dynahull-work" / spent).glob("*")
        assert {path.suffix for path in kept} <= {".done"}


def test_what_the_scans_say_counts_and_is_the_same_over_tiles(tmp_path):
    random = np.random.default_rng(5)
    points = room(500, random)
    scan = random.integers(0, 40, len(points)).astype(np.uint16)
    scan[-50:] = 17  # what moved was seen at once
    order = random.permutation(len(points))
    np.savez(tmp_path / "room.npz", points=points[order], scan=scan[order])
    wanted = ["removal.decision=auto", *SMALL_GROUND]
    report, table, _ = tiled([tmp_path / "room.npz"], tmp_path / "a", 60, *wanted)
    assert report.time == "scan, 40 scans"
    assert_same(table, in_memory([tmp_path / "room.npz"], *wanted))
    wanted += ["evidence.time=off"]
    report, without, _ = tiled([tmp_path / "room.npz"], tmp_path / "b", 60, *wanted)
    assert report.time == "none"
    assert_same(without, clean(points[order], load_configuration(None, [*FAST, *wanted]).method()))
    assert without["score"].to_numpy().tobytes() != table["score"].to_numpy().tobytes()


def test_what_scans_saw_through_counts_and_is_the_same_over_tiles(tmp_path):
    random = np.random.default_rng(5)
    points = random.permutation(room(500, random))
    scan = random.integers(0, 40, len(points)).astype(np.uint16)
    np.savez(tmp_path / "room.npz", points=points, scan=scan)
    wanted = ["removal.decision=auto", *SMALL_GROUND]
    _, timed, _ = tiled([tmp_path / "room.npz"], tmp_path / "a", 60, *wanted)
    wanted += [f"input.poses={poses_of(points, tmp_path, random)}"]
    report, table, _ = tiled([tmp_path / "room.npz"], tmp_path / "b", 60, *wanted)
    assert report.time == "scan, 40 scans with poses"
    assert_same(table, in_memory([tmp_path / "room.npz"], *wanted))
    assert timed["score"].to_numpy().tobytes() != table["score"].to_numpy().tobytes()


@pytest.mark.parametrize("halo", ["0", "0.3"])
def test_neighbours_are_found_across_every_border_of_small_tiles(halo, tmp_path):
    random = np.random.default_rng(10)
    np.save(
        tmp_path / "map.npy", KINDS["gridded"](random.uniform(size=(600, 3)) * [6, 5, 2], random)
    )
    wanted = ["ground.method=none", "clustering.count=1"]
    _, table, chunks = tiled(
        [tmp_path / "map.npy"], tmp_path / "out", 15, f"tiling.halo={halo}", *wanted
    )
    assert len(chunks) > 40
    assert_same(table, in_memory([tmp_path / "map.npy"], *wanted))


def test_ties_at_a_border_go_to_the_lower_row_whichever_side_it_is_on(tmp_path):
    # Six points are as near as the border may be, and rows choose the four that are neighbours.
    lattice = np.mgrid[:12, :16, :4].reshape(3, -1).T * 0.25
    np.save(tmp_path / "map.npy", np.random.default_rng(11).permutation(lattice))
    wanted = ["ground.method=none", "clustering.count=1", "neighbours.k=5"]
    _, table, chunks = tiled([tmp_path / "map.npy"], tmp_path / "out", 64, "tiling.halo=0", *wanted)
    assert len(chunks) == 12
    assert_same(table, in_memory([tmp_path / "map.npy"], *wanted))


def test_the_reference_device_says_the_same_over_tiles(tmp_path):
    random = np.random.default_rng(6)
    np.save(tmp_path / "room.npy", KINDS["gridded"](room(150, random), random))
    wanted = ["density.device=reference", "ground.method=none"]
    _, table, chunks = tiled(
        [tmp_path / "room.npy"], tmp_path / "out", 60, "tiling.halo=0.3", *wanted
    )
    assert len(chunks) > 3
    assert_same(table, in_memory([tmp_path / "room.npy"], *wanted))


@pytest.mark.parametrize("chunk_format", ["las", "laz"])
@pytest.mark.parametrize("kind", ["gridded", "duplicates"])
def test_chunks_in_las_give_the_same(kind, chunk_format, tmp_path):
    random = np.random.default_rng(7)
    points = KINDS[kind](random.permutation(room(300, random)), random)
    points[3] = np.nan
    np.save(tmp_path / "grid.npy", points)
    _, table, chunks = tiled(
        [tmp_path / "grid.npy"], tmp_path / "out", 60, f"tiling.format={chunk_format}",
        "tiling.halo=0.3", *SMALL_GROUND,
    )  # fmt: skip
    assert len(chunks) > 3
    assert {path.suffix for path in chunks} == {f".{chunk_format}"}
    assert_same(table, in_memory([tmp_path / "grid.npy"], *SMALL_GROUND))


def test_las_chunks_are_refused_where_no_grid_holds_the_map_and_nothing_is_written(
    room_file, tmp_path
):
    with pytest.raises(GridError, match=r"room\.npy.*integer \* scale \+ offset.*use Parquet"):
        tiled([room_file], tmp_path / "out", 60, "tiling.format=las")
    assert not (tmp_path / "out" / "static.npy").exists()


def las_map(path, points, classes):
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.scales, header.offsets = [0.001] * 3, [652_000, 5_401_000, 0]
    las = laspy.LasData(header)
    las.x, las.y, las.z = points.T
    las.classification = classes
    las.write(path)


def test_ground_classes_of_a_las_map_are_trusted_in_every_tile(tmp_path):
    random = np.random.default_rng(8)
    points = random.permutation(room(500, random)) + [652_345, 5_401_234, 431]
    classes = np.where(points[:, 2] < 431.1, 2, random.choice([0, 1, 6], len(points)))
    classes[random.choice(len(points), 60, replace=False)] = 2  # whatever the heights say
    las_map(tmp_path / "map.las", points, classes)
    for number, limit in enumerate(["null", "1"]):
        wanted = ["ground.method=las_class", f"max_height={limit}"]
        report, table, chunks = tiled(
            [tmp_path / "map.las"], tmp_path / f"out{number}", 80, "tiling.format=laz", *wanted
        )
        assert len(chunks) > 5
        assert report.counts["ground"] == (classes == 2).sum()
        assert (report.counts["above"] > 0) == (limit == "1")
        assert_same(table, in_memory([tmp_path / "map.las"], *wanted))


def test_several_files_are_cut_as_one_map(room_file, tmp_path):
    whole = np.load(room_file)
    (tmp_path / "parts").mkdir()
    for number, part in enumerate(np.split(whole, [200, 201, 600])):
        np.save(tmp_path / f"parts/part_{number}.npy", part)
    _, one, _ = tiled([room_file], tmp_path / "one", 100, *SMALL_GROUND)
    report, many, chunks = tiled([tmp_path / "parts"], tmp_path / "many", 100, *SMALL_GROUND)
    assert len(chunks) > 5
    assert_same_tables(many, one)
    assert_same(many, in_memory([room_file], *SMALL_GROUND))
    for name in ("static", "dynamic"):
        parts = [np.load(tmp_path / "many" / getattr(file, name)) for file in report.files]
        assert len(parts) == 4
        whole_again = np.load(tmp_path / f"one/{name}.npy")
        assert np.concatenate(parts).tobytes() == whole_again.tobytes()


def test_the_report_of_a_tiled_map_is_that_of_the_map_in_memory(room_file, tmp_path):
    one = cleaned([room_file], tmp_path / "one", *SMALL_GROUND)
    many, _, chunks = tiled([room_file], tmp_path / "many", 100, *SMALL_GROUND)
    assert len(chunks) > 5
    assert many.counts == one.counts
    assert many.clusters == one.clusters
    assert many.outputs == one.outputs
    for name in ("static.npy", "dynamic.npy"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "many" / name).read_bytes()


@pytest.mark.parametrize("decision", ["paper", "auto"])
def test_a_map_without_a_finite_point_passes_through(tmp_path, decision):
    np.save(tmp_path / "nothing.npy", np.full((9, 3), np.nan))
    wanted = f"removal.decision={decision}"
    report, table, chunks = tiled([tmp_path / "nothing.npy"], tmp_path / "out", 3, wanted)
    assert chunks == []
    assert report.counts["invalid"] == 9
    assert table["label"].to_pylist() == ["invalid"] * 9
    assert len(np.load(tmp_path / "out/static.npy")) == 9


class TestOneModelATile:
    """clustering.scope: tile."""

    WANTED = ("clustering.scope=tile", "clustering.count=2", "ground.method=none")

    def test_every_tile_has_its_own_clusters_and_eq_1_spans_all_of_them(self, room_file, tmp_path):
        report, table, chunks = tiled([room_file], tmp_path / "out", 150, *self.WANTED)
        assert len(chunks) > 3
        # A cluster's number tells its tile, and each tile has two of its own.
        cluster = table["cluster"].to_numpy()
        for tile, path in enumerate(chunks):
            chunk = pq.read_table(path)
            own = chunk["row"].to_numpy()[chunk["core"].to_numpy()]
            assert set(cluster[own]) == {2 * tile, 2 * tile + 1}
        counts = [each.count for each in report.clusters]
        assert [each.index for each in report.clusters] == list(range(2 * len(chunks)))
        assert counts == [Counter(cluster.tolist())[index] for index in range(len(counts))]
        assert sum(counts) == report.points
        low, high = min(counts), max(counts)
        for each in report.clusters:
            expected = 5 + 15 * (each.count - low) / (high - low)
            assert each.removal_percent == pytest.approx(expected)
            assert each.removed == int(each.removal_percent / 100 * each.count)
        assert sum(each.removed for each in report.clusters) == report.counts["dynamic"]
        self.assert_cut_at_the_threshold(table, report)

    @staticmethod
    def assert_cut_at_the_threshold(table, report):
        label = table["label"].to_numpy()
        cluster, density = table["cluster"].to_numpy(), table["density"].to_numpy()
        for each in report.clusters:
            dynamic = (cluster == each.index) & (label == "dynamic")
            kept = (cluster == each.index) & (label == "static")
            assert dynamic.sum() == each.removed
            assert (each.threshold is None) == (each.removed == 0)
            if each.removed:
                assert density[dynamic].max() <= each.threshold <= density[kept].min()

    def test_densities_are_of_the_clusters_of_the_whole_tile_s_model(self, room_file, tmp_path):
        """Every point's density is that of its cluster, its members of other tiles included."""
        _, first, _ = tiled([room_file], tmp_path / "first", 150, "tiling.halo=0", *self.WANTED)
        _, second, _ = tiled([room_file], tmp_path / "second", 150, "tiling.halo=3", *self.WANTED)
        assert_same_tables(first, second)

    def test_one_tile_is_the_whole_map(self, room_file, tmp_path):
        spread = np.load(room_file)
        spread[0] = np.nan
        np.save(room_file, spread)
        # As many points as a tile may hold, and one that is in no tile: cut, into a single tile.
        wanted = ["ground.method=none", "clustering.count=2"]
        report, table, chunks = tiled([room_file], tmp_path / "tile", len(spread) - 1, *self.WANTED)
        assert len(chunks) == 1
        assert_same(table, in_memory([room_file], *wanted))
        assert report.clusters == cleaned([room_file], tmp_path / "map", *wanted).clusters

    def test_tiles_without_ground_free_points_have_no_clusters(self, tmp_path):
        random = np.random.default_rng(9)
        floor = random.uniform(size=(800, 3)) * [20, 3, 0.005]
        wall = random.uniform(size=(200, 3)) * [4, 0.05, 2.2] + [0, 1.5, 0.3]
        np.save(tmp_path / "floor.npy", np.concatenate([floor, wall]))
        wanted = ["clustering.scope=tile", "clustering.count=2", *SMALL_GROUND]
        report, table, chunks = tiled(
            [tmp_path / "floor.npy"], tmp_path / "out", 100, "tiling.halo=1", *wanted
        )
        indices = [each.index for each in report.clusters]
        assert 0 < len(indices) < 2 * len(chunks)
        found = Counter(table["cluster"].to_pylist())
        assert [found[index] for index in indices] == [each.count for each in report.clusters]
        assert len(table) - found[-1] == sum(each.count for each in report.clusters)
        assert sum(each.removed for each in report.clusters) == report.counts["dynamic"]
        assert sum(report.counts.values()) == report.points


@pytest.fixture(scope="module", params=["paper", "auto"])
def corridor_in_memory(request, shared_data, tmp_path_factory):
    """How it was decided, and the output folder."""
    folder, decision = tmp_path_factory.mktemp("corridor"), f"removal.decision={request.param}"
    cleaned([shared_data / "maps/corridor.pcd"], folder, "neighbours.k=20", decision)
    return decision, folder


@pytest.mark.parametrize(
    ("tiles", "halo", "workers"),
    [(4, "auto", ["execution.cluster=local", "execution.workers=2"]), (40, "0.5", [])],
    ids=["4 tiles, 2 workers", "40 tiles"],
)
def test_a_real_map_has_the_same_bytes(
    tiles, halo, workers, corridor_in_memory, shared_data, tmp_path
):
    decision, in_one = corridor_in_memory
    source = shared_data / "maps/corridor.pcd"
    count = MapCollection([source]).point_count
    wanted = [f"tiling.halo={halo}", "neighbours.k=20", decision, *workers]
    _, _, chunks = tiled([source], tmp_path, 2 * count // tiles, *wanted)
    assert tiles / 2 <= len(chunks) <= 2 * tiles
    for name in ("static.pcd", "dynamic.pcd", "labels.parquet"):
        assert (tmp_path / name).read_bytes() == (in_one / name).read_bytes()
    report = json.loads((tmp_path / "run.json").read_text(encoding="utf-8"))
    whole = json.loads((in_one / "run.json").read_text(encoding="utf-8"))
    assert report["clusters"] == whole["clusters"]
