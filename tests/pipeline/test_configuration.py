"""Configuration: every mistake is one line that says where, what, and what is allowed."""

from pathlib import Path

import pytest
from pydantic import BaseModel

from pipeline.areas import read_areas
from pipeline.configuration.page import configuration_page
from pipeline.configuration.run import Configuration, load_configuration, ready_configurations
from pipeline.errors import ConfigurationError
from tiling.errors import MapFormatError
from tiling.key_frames import read_poses

CONFIGS = (Path(__file__).parents[2] / "configs").glob("*.yaml")
READY = sorted(path.stem for path in CONFIGS if path.stem != "nightly")


def write(folder, text):
    path = folder / "my.yaml"
    path.write_text(text, encoding="utf-8")
    return str(path)


def test_the_defaults_are_the_paper_s_but_for_the_decision():
    configuration = load_configuration(None)
    assert configuration.neighbours.k == 75
    assert configuration.clustering.count == 5
    assert (configuration.removal.min_percent, configuration.removal.max_percent) == (5, 20)
    assert load_configuration("auto") == configuration
    assert load_configuration("paper") == load_configuration(None, ["removal.decision=paper"])


@pytest.mark.parametrize(
    ("settings", "decision"),
    [
        ([], "auto"),
        (["removal.confidence=0.7"], "auto"),
        (["neighbours.k=50"], "auto"),
        (["removal.max_percent=8"], "paper"),
        (["removal.min_percent=3"], "paper"),
        (["removal.threshold=stepped"], "paper"),
        (["removal.max_percent=8", "removal.decision=auto"], "auto"),
    ],
)
def test_a_key_of_equation_1_asks_for_the_paper_s_decision(settings, decision):
    assert load_configuration(None, settings).removal.decision == decision


def test_the_ready_configurations_come_with_the_package():
    assert {"paper", "indoor", "outdoor"} <= set(READY)
    assert sorted(ready_configurations()) == READY


@pytest.mark.parametrize("name", READY)
def test_every_ready_configuration_is_valid_and_survives_its_own_yaml(name, tmp_path):
    configuration = load_configuration(name)
    assert load_configuration(write(tmp_path, configuration.to_yaml())) == configuration


def test_a_file_wins_over_a_ready_configuration_of_its_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("paper").write_text("neighbours: {k: 10}", encoding="utf-8")
    assert load_configuration("paper").neighbours.k == 10


def test_a_name_that_is_nearly_that_of_a_ready_configuration_is_named():
    with pytest.raises(ConfigurationError, match=r"no such file; did you mean outdoor\?$"):
        load_configuration("ouutdoor")
    with pytest.raises(ConfigurationError, match=r"found no such file$"):
        load_configuration("mine.yaml")


def test_settings_win_over_the_file_and_the_last_wins(tmp_path):
    source = write(tmp_path, "neighbours: {k: 30}\nmax_height: 2.5\n")
    configuration = load_configuration(source, ["neighbours.k=40", "neighbours.k=50"])
    assert configuration.neighbours.k == 50
    assert configuration.max_height == 2.5
    assert load_configuration(source, ["max_height=null"]).max_height is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "clustering: {cont: 3}",
            r"\.cont: no such key; did you mean count\? allowed: count",
        ),
        (
            "clusterin: {count: 3}",
            r"no such key; did you mean clustering\? allowed: ground",
        ),
        ("neighbours: {k: many}", "neighbours.k: input should be a valid integer"),
        ("neighbours: {k: 3}", "neighbours.k: input should be greater than or equal to 4, found 3"),
        ("removal: {min_percent: 30}", r"min_percent \(30\) is above max_percent \(20\)"),
        ("removal: {threshold: best}", "removal.threshold: input should be 'rank' or 'stepped'"),
        ("- a\n- b", "expected sections with keys, found"),
        ("a: [1", "not YAML at line 1: expected"),
        ("neighbours: 5", r"neighbours: expected a section of keys \(k\), found 5"),
    ],
)
def test_mistakes_in_a_file_are_one_line(text, message, tmp_path):
    source = write(tmp_path, text)
    with pytest.raises(ConfigurationError, match=message) as error:
        load_configuration(source)
    assert str(error.value).startswith(source)
    assert "\n" not in str(error.value)


def test_files_that_are_no_text_are_refused_in_words(tmp_path):
    path = tmp_path / "bytes"
    path.write_bytes(b"\xff\xfe\x00")
    for read in (load_configuration, read_areas, read_poses):
        with pytest.raises((ConfigurationError, MapFormatError), match=r"expected .*no text"):
            read(path if read is not load_configuration else str(path))


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("neighbours.k", "expected section.key=value"),
        ("=5", "expected section.key=value"),
        ("neighbours.n=5", "neighbours.n: no such key"),
        ("neighbours.k=[1", "expected a YAML value"),
        ("max_height.k=1", "max_height"),
        ("k=50", r"k: no such key; did you mean neighbours\.k\?"),
        ("confidence=0.7", r"did you mean removal\.confidence\?"),
        ("execution.workers=0", "execution.workers: input .* equal to 1, or 'auto', found 0"),
        ("execution.memory=lots", "execution.memory: expected a size such as 2GiB, or 'auto'"),
        ("cluster.walltime=long", "cluster.walltime: expected a duration such as 90 min"),
        ("removal.protect=[{rings: 3}]", "removal.protect.0.rings: input"),
    ],
)
def test_mistakes_in_a_setting_are_one_line(setting, message):
    with pytest.raises(ConfigurationError, match=message):
        load_configuration(None, ["max_height=2", setting])


def test_what_a_setting_does_to_a_file_is_not_laid_at_its_door(tmp_path):
    good, bad = write(tmp_path, "removal: {min_percent: 4}"), tmp_path / "bad.yaml"
    with pytest.raises(ConfigurationError, match=r"^configuration: removal: min_percent \(4\)"):
        load_configuration(good, ["removal.max_percent=3"])
    bad.write_text("removal: {min_percent: 40}", encoding="utf-8")
    with pytest.raises(ConfigurationError, match=r"bad.yaml: removal: min_percent \(40\)"):
        load_configuration(str(bad), ["removal.confidence=0.3"])
    with pytest.raises(ConfigurationError, match="expected a YAML file, found a folder"):
        load_configuration(str(tmp_path))


DESIGN = """
ground:      {method: slope}
max_height:  null
clustering:  {count: 5, scope: map, seed: 0}
neighbours:  {k: 75}
density:     {device: cpu}
removal:     {min_percent: 5, max_percent: 20, threshold: rank}
tiling:      {max_points: auto, halo: auto, format: parquet}
execution:   {cluster: local, scheduler: null, workers: auto, memory: auto}
output:      {mode: split, labels: auto, keep_work: false}
"""


def test_all_sections_and_keys_of_the_design_are_known(tmp_path):
    assert load_configuration(write(tmp_path, DESIGN)) == load_configuration("paper")


def test_a_section_without_keys_has_its_defaults(tmp_path):
    source = write(tmp_path, "neighbours:\n  # k: 50\nmax_height: null\n")
    assert load_configuration(source) == load_configuration(None)


@pytest.mark.parametrize(
    "setting", ["neighbours.k=2024-13-45", "neighbours.k=0x_", "neighbours.k=" + "[" * 3000,
                "execution.workers=0", "execution.workers=true"]
)  # fmt: skip
def test_values_that_yaml_or_the_model_chokes_on_are_one_line(setting):
    with pytest.raises(ConfigurationError):
        load_configuration(None, [setting])


def test_an_empty_name_is_no_configuration():
    with pytest.raises(ConfigurationError, match="found nothing"):
        load_configuration("")


def test_a_missing_file_names_the_ready_configurations():
    with pytest.raises(ConfigurationError, match=r"nowhere.yaml: .*outdoor, paper, slurm\)"):
        load_configuration("nowhere.yaml")


def test_the_page_in_the_documentation_is_up_to_date():
    page = (Path(__file__).parents[2] / "docs" / "configuration.md").read_text(encoding="utf-8")
    assert page == configuration_page(), "dynahull-pipeline keys > docs/configuration.md"
    assert "| `neighbours.k` | 75 | whole number, >= 4, <= 1000 |" in page
    assert "| `max_height` | null | number, null, > 0 |" in page
    assert "| `execution.workers` | auto | whole number, `auto`, >= 1 |" in page


def test_every_key_is_documented():
    def undocumented(model: type[BaseModel], place: str) -> list[str]:
        missing = []
        for name, field in model.model_fields.items():
            inner = field.annotation
            if isinstance(inner, type) and issubclass(inner, BaseModel):
                missing += undocumented(inner, f"{place}{name}.")
            elif not field.description:
                missing.append(place + name)
        return missing

    assert undocumented(Configuration, "") == []
