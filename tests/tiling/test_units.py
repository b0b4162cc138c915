"""Units of a map: from well-known text of every kind, and from GeoTIFF keys."""

import struct
from importlib import import_module

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tiling.formats import open_map
from tiling.formats.las.crs import units_in_geo_keys, units_in_wkt
from tiling.formats.units import DEGREE, FOOT, METRE, US_SURVEY_FOOT, length

GEOGCS = 'GEOGCS["a",DATUM["b",SPHEROID["c",6378137,298.25]],UNIT["degree",0.0174532925199433]]'


def metres(units):
    if units is None:
        return None
    return tuple(unit and unit.metres for unit in (units.horizontal, units.vertical))


@pytest.mark.parametrize(
    ("text", "found"),
    [
        (f'PROJCS["p",{GEOGCS},UNIT["metre",1]]', (METRE, None)),
        (f'PROJCS["p",{GEOGCS},UNIT["Foot_US",0.3048006096012192]]', (US_SURVEY_FOOT, None)),
        (f'PROJCS["p",{GEOGCS},UNIT["US survey foot",0.304800609601219]]', (US_SURVEY_FOOT, None)),
        (f'projcs("p",{GEOGCS},unit("foot", 0.3048))', (FOOT, None)),
        # Esri's vertical system within the projected one, with a factor that is not believed.
        (
            f'PROJCS["p",{GEOGCS},UNIT["foot",0.3048],VERTCS["v",UNIT["US survey foot",1.0]]]',
            (FOOT, US_SURVEY_FOOT),
        ),
        (
            f'COMPD_CS["x",PROJCS["p",{GEOGCS},UNIT["metre",1]],VERT_CS["v",UNIT["ftUS",0.3048006]]]',
            (METRE, US_SURVEY_FOOT),
        ),
        (f'PROJCS["p",{GEOGCS},UNIT["metre",1]],VERTCS["v",UNIT["Foot",0.3048]]', (METRE, FOOT)),
        (GEOGCS, (None, None)),
        (f'COMPD_CS["x",{GEOGCS},VERT_CS["v",UNIT["metre",1]]]', (None, METRE)),
        ('GEOCCS["unnamed",DATUM["d"],UNIT["metre",1]]', (METRE, None)),
        ('LOCAL_CS["site",UNIT["foot",0.3048]]', (FOOT, None)),
        (
            'GEODCRS["g",CS[Cartesian,3],AXIS["X",geocentricX],LENGTHUNIT["metre",1]]',
            (METRE, None),
        ),
        (
            'PROJCRS["p",CS[Cartesian,3],AXIS["E",east,LENGTHUNIT["metre",1]],'
            'AXIS["N",north,LENGTHUNIT["metre",1]],AXIS["h",up,LENGTHUNIT["foot",0.3048]]]',
            (METRE, FOOT),
        ),
        (
            'BOUNDCRS[SOURCECRS[PROJCRS["p",CS[Cartesian,2],LENGTHUNIT["foot",0.3048]]]]',
            (FOOT, None),
        ),
        (f'PROJCS["p, [odd ""name""]",{GEOGCS},UNIT["metre",1]]', (METRE, None)),
        ("''", None),
        ("", None),
        ("PROJCS[", None),
        ("[" * 1000, None),
    ],
)
def test_units_in_well_known_text(text, found):
    assert metres(units_in_wkt(text)) == found


@given(st.text(alphabet='PROJCSUNIT["],()1.e- \x00é', max_size=200))
def test_text_that_makes_no_sense_stops_nothing(text):
    units_in_wkt(text)


@pytest.mark.parametrize(
    ("code", "form"), [(2263, "WKT1_GDAL"), (2263, "WKT1_ESRI"), (2263, "WKT2_2019")]
)
@pytest.mark.parametrize("vertical", [None, 5703, 6360])
def test_text_that_other_software_writes(code, form, vertical):
    pyproj = pytest.importorskip("pyproj", reason="pyproj is not installed")
    name = f"EPSG:{code}" + (f"+{vertical}" if vertical else "")
    units = units_in_wkt(pyproj.CRS(name).to_wkt(form))
    assert metres(units) == (
        US_SURVEY_FOOT,
        {None: None, 5703: METRE, 6360: US_SURVEY_FOOT}[vertical],
    )


@pytest.mark.parametrize("form", ["WKT1_GDAL", "WKT1_ESRI", "WKT2_2015", "WKT2_2019"])
@pytest.mark.parametrize("code", [4326, 4979])
def test_degrees_that_other_software_writes(code, form):
    pyproj = pytest.importorskip("pyproj", reason="pyproj is not installed")
    try:
        text = pyproj.CRS(code).to_wkt(form)
    except pyproj.exceptions.CRSError:
        pytest.skip("no such form of this system")
    if text is None:
        pytest.skip("no such form of this system")
    assert units_in_wkt(text).horizontal == DEGREE


def directory(*keys):
    words = [1, 1, 0, len(keys)]
    for key in keys:
        words += key
    return struct.pack(f"<{len(words)}H", *words)


@pytest.mark.parametrize(
    ("keys", "found"),
    [
        ([(1024, 0, 1, 1), (3076, 0, 1, 9001)], (METRE, None)),
        ([(1024, 0, 1, 1), (3072, 0, 1, 2994), (3076, 0, 1, 9002)], (FOOT, None)),
        ([(3076, 0, 1, 9003), (4099, 0, 1, 9001)], (US_SURVEY_FOOT, METRE)),
        ([(1024, 0, 1, 2), (2048, 0, 1, 4326), (2054, 0, 1, 9102)], (None, None)),
        ([(2048, 0, 1, 4326)], (None, None)),
        ([(1024, 0, 1, 3), (2048, 0, 1, 4326), (2052, 0, 1, 9001)], (METRE, None)),
        ([(3076, 0, 1, 32767), (3077, 34736, 1, 1)], (FOOT, None)),
        ([(3076, 0, 1, 32767), (3077, 34736, 1, 9)], None),
        ([(3076, 0, 1, 32632)], None),
        ([], None),
    ],
)
def test_units_in_geo_keys(keys, found):
    assert metres(units_in_geo_keys(directory(*keys), struct.pack("<2d", 7, FOOT))) == found


def test_keys_that_name_a_system_by_its_code_alone(monkeypatch):
    pytest.importorskip("pyproj", reason="pyproj is not installed")
    keys = directory((1024, 0, 1, 1), (3072, 0, 1, 2263))
    assert metres(units_in_geo_keys(keys, b"")) == (US_SURVEY_FOOT, None)
    assert metres(units_in_geo_keys(directory((3072, 0, 1, 4326)), b"")) == (None, None)
    monkeypatch.setitem(import_module("sys").modules, "pyproj", None)
    assert units_in_geo_keys(keys, b"") is None


@given(st.binary(max_size=80), st.binary(max_size=16))
def test_keys_that_make_no_sense_stop_nothing(keys, doubles):
    units_in_geo_keys(keys, doubles)


@pytest.mark.parametrize(
    ("name", "given_metres", "found"),
    [
        ("metre", 1.0, METRE),
        ("US survey foot", 1.0, US_SURVEY_FOOT),
        ("foot", 0.304800609601219, US_SURVEY_FOOT),
        ("", 0.3048, FOOT),
        ("rod", 5.0292, 5.0292),
        ("metre", float("nan"), METRE),
        ("rod", 0.0, None),
    ],
)
def test_lengths_by_name_and_factor(name, given_metres, found):
    unit = length(name, given_metres)
    assert (unit and unit.metres) == found


@pytest.mark.parametrize(
    ("name", "found"),
    [
        ("laspy-test__1_4_w_evlr.las", (US_SURVEY_FOOT, US_SURVEY_FOOT)),
        ("laspy-test__autzen_geo_proj.las", (FOOT, None)),
        ("laspy-test__fullwave.laz", (METRE, None)),
        ("laspy-test__simple1_3.las", (None, METRE)),
        ("laspy-test__simple_with_page.copc.laz", (METRE, US_SURVEY_FOOT)),
        ("pdal-test__autzen-dd.las", (None, None)),
        ("pdal-test__split-1.laz", (METRE, None)),
        ("pdal-test__test_epsg_4047.las", (None, None)),
    ],
)
def test_units_of_real_files(shared_data, name, found):
    assert metres(open_map(shared_data / "formats" / name).description.units) == found
