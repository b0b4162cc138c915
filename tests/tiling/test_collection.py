import hashlib
from pathlib import Path

import numpy as np
import pytest

from tiling.collection import MapCollection, content_hash, find_map_files
from tiling.errors import MapFormatError, NoMapError, TilingError, UnknownFormatError


@pytest.fixture
def folder(tmp_path: Path, monkeypatch) -> Path:
    """A folder with maps of 2, 10 and 3 points, and with what is no map."""
    monkeypatch.chdir(tmp_path)
    for name, count in {"cell_2": 2, "cell_10": 10, "Cell_1": 3}.items():
        np.save(tmp_path / f"{name}.npy", np.full((count, 3), count, dtype=float))
    np.save(tmp_path / ".hidden.npy", np.zeros((1, 3)))
    (tmp_path / "README.md").write_text("no map")
    (tmp_path / "deep" / "deeper").mkdir(parents=True)
    np.save(tmp_path / "deep" / "deeper" / "far.npy", np.zeros((1, 3)))
    return tmp_path


def names(*arguments: str | Path) -> list[str]:
    return [path.name for path in find_map_files(arguments)]


def test_a_folder_means_the_maps_in_it_in_natural_order(folder):
    assert names(folder) == ["Cell_1.npy", "cell_2.npy", "cell_10.npy"]
    assert names(".") == ["Cell_1.npy", "cell_2.npy", "cell_10.npy"]


def test_a_folder_of_partitions_is_one_map(tmp_path):
    names = ["day=2/hour=1/part-1.npy", "day=10/part-0.npy", "day=2/hour=1/part-0.npy"]
    for name in [*names, "day=2/_SUCCESS", "day=2/.part-1.npy.crc", "other/part-0.npy"]:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    (tmp_path / "day=2" / "again=1").symlink_to(tmp_path)
    found = [str(path.relative_to(tmp_path)) for path in find_map_files([tmp_path])]
    assert found == [names[2], names[0], names[1]]


def test_a_pattern_means_the_maps_it_matches(folder):
    assert names("cell_*") == ["cell_2.npy", "cell_10.npy"]
    assert names("*") == ["Cell_1.npy", "cell_2.npy", "cell_10.npy"]
    assert names(f"{folder}/**/*.npy") == ["Cell_1.npy", "cell_2.npy", "cell_10.npy", "far.npy"]
    assert names("[Cc]ell_[12].npy") == ["Cell_1.npy", "cell_2.npy"]


def test_a_file_of_that_very_name_is_no_pattern(folder):
    np.save(folder / "map[1].npy", np.zeros((1, 3)))
    np.save(folder / "map1.npy", np.zeros((1, 3)))
    assert names("map[1].npy") == ["map[1].npy"]


def test_a_file_named_twice_counts_once(folder):
    (folder / "link.npy").symlink_to(folder / "cell_2.npy")
    found = names("cell_10.npy", "./cell_10.npy", folder / "deep/../cell_10.npy", "link.npy", ".")
    assert found == ["cell_10.npy", "link.npy", "Cell_1.npy"]


def test_a_file_named_outright_is_kept_whatever_its_suffix(folder):
    paths = find_map_files(["README.md"])
    assert paths == (Path("README.md"),)
    with pytest.raises(UnknownFormatError):
        MapCollection(paths)


@pytest.mark.parametrize(
    ("argument", "found"),
    [
        ("absent.pcd", "no such file or folder"),
        ("deep", "a folder with no files"),
        ("*.md", "a pattern with 1 other file and no"),
        ("*.pcd", "a pattern with no files"),
    ],
)
def test_arguments_that_name_no_map(folder, argument, found):
    with pytest.raises(NoMapError) as raised:
        find_map_files([argument])
    assert str(raised.value).startswith(f"{argument}: expected a map")
    assert found in str(raised.value)
    assert isinstance(raised.value, TilingError)


def test_no_arguments():
    with pytest.raises(NoMapError):
        find_map_files([])
    with pytest.raises(NoMapError):
        MapCollection([])


def test_a_collection_numbers_its_points_on(folder):
    collection = MapCollection(find_map_files([folder]))
    assert collection.paths == find_map_files([folder])
    assert collection.point_count == 15
    assert collection.first_rows == (0, 3, 5)
    assert not collection.has_classification
    row = 0
    for file, batch in collection.batches(4):
        assert batch.first_row == row
        assert len(batch.xyz) <= 4
        assert (batch.xyz == [3, 2, 10][file]).all()
        row += len(batch.xyz)
    assert row == 15


def test_a_broken_file_is_named(folder):
    (folder / "cell_3.npy").write_bytes(b"version https://git-lfs.github.com/spec/v1")
    with pytest.raises(MapFormatError, match=r"cell_3\.npy: expected"):
        MapCollection(find_map_files([folder]))


def test_the_hash_of_one_file_is_that_of_its_bytes(folder):
    path = folder / "cell_2.npy"
    assert content_hash([path]) == hashlib.sha256(path.read_bytes()).hexdigest()


def test_the_hash_of_several_files_tells_their_order_and_borders(tmp_path):
    contents = [b"ab", b"c", b"a", b"bc", b"abc"]
    paths = [tmp_path / str(number) for number in range(5)]
    for path, content in zip(paths, contents, strict=True):
        path.write_bytes(content)
    ab, c, a, bc, abc = paths
    digests = [content_hash(each) for each in ([ab, c], [c, ab], [a, bc], [abc])]
    assert len(set(digests)) == len(digests)


def test_a_folder_that_cannot_be_read_is_named(tmp_path, monkeypatch):
    def denied(self):
        raise PermissionError(13, "Permission denied", str(self))

    monkeypatch.setattr(type(tmp_path), "iterdir", denied)
    with pytest.raises(NoMapError, match=r"expected a map, .*cannot be read \(Permission denied"):
        find_map_files([tmp_path])


def test_hashing_tells_how_far_it_is_and_may_be_ended(tmp_path):
    paths = [tmp_path / name for name in "ab"]
    for path in paths:
        path.write_bytes(b"x" * 1_500_000)
    seen = []
    assert content_hash(paths, seen.append) == content_hash(paths)
    assert sum(seen) == 3_000_000
    assert len(seen) > len(paths)

    def enough(size):
        raise InterruptedError

    with pytest.raises(InterruptedError):
        content_hash(paths, enough)
