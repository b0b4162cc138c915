"""E57 through libE57: scans, poses and every field, and the tree around them."""

import resource
import signal
from pathlib import Path

import numpy as np
import pytest

from tiling.errors import MapFormatError
from tiling.formats import Field, open_map
from tiling.formats.e57.nodes import children, node, opened

libe57 = pytest.importorskip("pye57.libe57", reason="pye57 is not installed (extra e57)")
COUNTS = (60, 0, 40)


def structure(image, **members):
    made = libe57.StructureNode(image)
    for name, value in members.items():
        made.set(name.replace("__", ":"), value)
    return made


def real(image, value):
    return libe57.FloatNode(image, value)


def text(image, value):
    return libe57.StringNode(image, value)


def prototype(image, kind):
    if kind == 0:
        low, high = -(2**40), 2**40
        scaled = [libe57.ScaledIntegerNode(image, 0, low, high, 0.001, 5.0) for _ in "xyz"]
        axes = dict(zip(("cartesianX", "cartesianY", "cartesianZ"), scaled, strict=True))
        return structure(
            image,
            **axes,
            cartesianInvalidState=libe57.IntegerNode(image, 0, 0, 2),
            intensity=libe57.FloatNode(image, 0.0, libe57.E57_SINGLE, 0.0, 1.0),
            nor__normalX=libe57.FloatNode(image, 0.0, libe57.E57_SINGLE),
            rowIndex=libe57.IntegerNode(image, 0, 0, 10_000),
        )
    names = ("sphericalRange", "sphericalAzimuth", "sphericalElevation")
    return structure(image, **{name: real(image, 0.0) for name in names})


def values_of(kind, count):
    random = np.random.default_rng(kind)
    if kind == 0:
        columns = {axis: random.integers(-9999, 9999, count) for axis in "XYZ"}
        return {
            **{f"cartesian{axis}": column for axis, column in columns.items()},
            "cartesianInvalidState": np.arange(count) % 10 // 9,
            "intensity": random.random(count).astype("f4"),
            "nor:normalX": random.normal(size=count).astype("f4"),
            "rowIndex": np.arange(count),
        }
    return {
        "sphericalRange": random.uniform(1, 9, count),
        "sphericalAzimuth": random.uniform(-3, 3, count),
        "sphericalElevation": random.uniform(-1, 1, count),
    }


def write_e57(path: Path, counts=COUNTS, grouped=False, picture=3_000_000) -> None:
    """Write scans of scaled integers and of spherical coordinates by turns, and a picture."""
    image = libe57.ImageFile(str(path), "w")
    image.extensionsAdd("", libe57.E57_V1_0_URI)
    image.extensionsAdd("nor", "http://www.libe57.org/E57_NOR_surface_normals.txt")
    root = image.root()
    root.set("formatName", text(image, "ASTM E57 3D Imaging Data File"))
    root.set("guid", text(image, "{ä file}"))
    root.set("versionMajor", libe57.IntegerNode(image, 1))
    root.set("coordinateMetadata", text(image, ""))
    scans, pictures = libe57.VectorNode(image, True), libe57.VectorNode(image, True)
    root.set("data3D", scans)
    root.set("images2D", pictures)
    for number, count in enumerate(counts):
        kind = number % 2
        turn = structure(image, w=real(image, 0.5), **{a: real(image, 0.5) for a in "xyz"})
        shift = structure(image, **{a: real(image, n + 0.1) for n, a in enumerate("xyz")})
        scan = structure(image, guid=text(image, f"scan {number}"))
        if number != 1:
            scan.set("pose", structure(image, rotation=turn, translation=shift))
        if grouped:
            scan.set("pointGroupingSchemes", structure(image))
        scans.append(scan)
        codecs = libe57.VectorNode(image, True)
        points = libe57.CompressedVectorNode(image, prototype(image, kind), codecs)
        scan.set("points", points)
        buffers = libe57.VectorSourceDestBuffer()
        columns = {
            name: values.astype("q") if values.dtype.kind == "i" else values
            for name, values in values_of(kind, max(count, 1)).items()
        }
        for name, column in columns.items():
            buffers.append(libe57.SourceDestBuffer(image, name, column, len(column), False, False))
        writer = points.writer(buffers)
        if count:
            writer.write(count)
        writer.close()
    blob = libe57.BlobNode(image, picture)
    pictures.append(structure(image, guid=text(image, "picture"), jpegImage=blob))
    content = np.random.default_rng(9).integers(0, 256, picture).astype("u1")
    blob.write(content, 0, len(content))
    image.close()


def tree_of(path: Path) -> dict[str, object]:
    """All nodes but the points, by their paths."""
    found = {}

    def walk(each, place):
        kind = type(each).__name__
        said = [kind]
        for name in ("value", "rawValue", "minimum", "maximum", "scale", "offset", "precision"):
            if hasattr(each, name):
                said.append(getattr(each, name)())
        if kind == "BlobNode":
            content = np.empty(each.byteCount(), "u1")
            each.read(content, 0, len(content))
            said.append(content.tobytes())
        found[place] = said
        if kind in ("StructureNode", "VectorNode"):
            for child in children(each):
                walk(child, f"{place}/{child.elementName()}")
        if kind == "CompressedVectorNode":
            walk(node(each.prototype()), f"{place}/prototype")

    with opened(path) as image:
        walk(image.root(), "")
        found["extensions"] = [image.extensionsUri(n) for n in range(image.extensionsCount())]
    return found


@pytest.fixture
def e57(tmp_path):
    write_e57(tmp_path / "map.e57")
    return tmp_path / "map.e57"


@pytest.mark.parametrize("most", [7, 1000])
def test_scans_are_in_the_frame_of_the_map(e57, read_xyz, most):
    reader = open_map(e57)
    assert reader.description.format == "E57, 3 scans"
    xyz = read_xyz(reader, most)
    for first, kind, number in ((0, 0, 0), (60, 0, 2)):
        values = values_of(kind, COUNTS[number])
        own = np.stack([values[f"cartesian{a}"] * 0.001 + 5.0 for a in "XYZ"], axis=1)
        expected = own[:, [2, 0, 1]] + [0.1, 1.1, 2.1]  # a third of a turn about (1, 1, 1)
        expected[values["cartesianInvalidState"] != 0] = np.nan
        np.testing.assert_allclose(xyz[first : first + COUNTS[number]], expected, rtol=1e-12)
    (batch,) = reader.batches(1000, range(60, 100))
    np.testing.assert_array_equal(batch.xyz, xyz[60:])


def test_spherical_coordinates(tmp_path, read_xyz):
    write_e57(tmp_path / "map.e57", (0, 50))
    values = values_of(1, 50)
    r, a, e = (values[f"spherical{name}"] for name in ("Range", "Azimuth", "Elevation"))
    expected = np.stack([r * np.cos(e) * np.cos(a), r * np.cos(e) * np.sin(a), r * np.sin(e)], 1)
    xyz = read_xyz(open_map(tmp_path / "map.e57"))
    np.testing.assert_allclose(xyz, expected, rtol=1e-12)


@pytest.mark.parametrize("share", [0.0, 0.4, 1.0])
@pytest.mark.parametrize("most", [7, 1000])
def test_every_field_and_the_tree_come_back(e57, tmp_path, rewrite, share, most):
    reader = open_map(e57)
    chosen = np.random.default_rng(0).random(100) < share
    copy = rewrite(reader, tmp_path / "copy.e57", chosen, most)
    before = b"".join(
        batch.select(chosen[batch.first_row :][: len(batch.xyz)]).tobytes()
        for batch in reader.batches(1000)
    )
    after = b"".join(batch.records.tobytes() for batch in open_map(copy).batches(1000))
    assert after == before
    assert tree_of(copy) == tree_of(e57)


def test_groups_of_points_are_left_out_with_a_note(tmp_path, rewrite):
    write_e57(tmp_path / "map.e57", (9,), grouped=True)
    reader = open_map(tmp_path / "map.e57")
    assert reader.description.notes == ("The grouping of the points by lines is left out.",)
    copy = rewrite(reader, tmp_path / "copy.e57", np.ones(9, bool), 5)
    assert open_map(copy).description.notes == ()


def test_further_fields_are_refused(e57):
    with pytest.raises(MapFormatError, match="--labels writes them beside"):
        open_map(e57).extended([Field("label", "uint8")])


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda _: b"", "expected an E57 file, found an empty file"),
        (lambda data: data[:2000], "expected a whole E57 file, found"),
        (lambda data: data[:3000] + b"\0" + data[3001:], "expected a whole E57 file, found"),
        (lambda _: b"version https://git-lfs.github.com/spec/v1", "a git-LFS pointer"),
    ],
)
def test_broken_files_are_refused_in_one_line(e57, read_xyz, spoil, message):
    e57.write_bytes(spoil(e57.read_bytes()))
    with pytest.raises(MapFormatError, match=message) as raised:
        read_xyz(open_map(e57))
    assert len(str(raised.value)) < 400


def test_without_pye57_it_is_said_what_to_install(e57, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pye57.libe57", None)
    with pytest.raises(MapFormatError, match=r"pip install 'dynahull-pipeline\[e57\]'"):
        open_map(e57)


def test_a_disk_that_is_full_is_told_as_such(e57, tmp_path):
    reader = open_map(e57)
    with pytest.raises(OSError, match=r"File too large|cannot be written"):
        limited(reader, tmp_path / "copy.e57")


def limited(reader, path):
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, before[1]))
    try:
        with reader.writer(path, 100) as writer:
            for batch in reader.batches():
                writer.write(batch.records)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
