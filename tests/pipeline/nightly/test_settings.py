"""What can be told to a night, and what each mistake is answered with."""

from pathlib import Path

import pytest
import yaml

from pipeline.configuration.run import configurations_folder
from pipeline.errors import ConfigurationError
from pipeline.nightly.inventory import find_maps
from pipeline.nightly.settings import load_nightly_settings


def write(folder, text="inputs: [{maps: incoming}]\noutput: out\n"):
    path = folder / "nightly.yaml"
    path.write_text(text)
    return path


def test_the_ready_file_is_valid_and_names_every_key():
    source = configurations_folder() / "nightly.yaml"
    settings = load_nightly_settings(source)
    assert set(yaml.safe_load(source.read_text())) == set(type(settings).model_fields)
    assert (settings.settle, settings.wait, settings.stop_after) == (600, 1800, 21600)
    assert settings.keep_free == 10 << 30


def test_paths_are_relative_to_the_file(tmp_path):
    (tmp_path / "mine.yaml").write_text("neighbours: {k: 9}\n")
    text = (
        "inputs: [{maps: in/*.pcd, configuration: mine.yaml}, {maps: /srv/x, configuration: paper}]"
    )
    settings = load_nightly_settings(write(tmp_path, f"{text}\noutput: ../out\n"))
    assert settings.inputs[0].maps == f"{tmp_path}/in/*.pcd"
    assert settings.inputs[1].maps == "/srv/x"
    assert settings.output == Path(f"{tmp_path}/../out")
    assert [settings.configuration_of(each).neighbours.k for each in settings.inputs] == [9, 75]


def test_a_folder_whose_name_has_wildcards_means_itself(tmp_path):
    folder = tmp_path / "old [1]*"
    (folder / "in").mkdir(parents=True)
    (folder / "in" / "a.npy").write_bytes(b"x")
    for maps in ("in", "in/*.npy", "**/*.npy"):
        text = f"inputs: [{{maps: '{maps}'}}]\noutput: out\n"
        settings = load_nightly_settings(write(folder, text))
        configurations = [settings.configuration_of(each) for each in settings.inputs]
        found, problems = find_maps(settings, configurations)
        assert [each.path.name for each in found] == ["a.npy"]
        assert problems == []


def test_space_is_left_by_every_run(tmp_path):
    settings = load_nightly_settings(write(tmp_path), ["keep_free=1GiB"])
    assert settings.configuration_of(settings.inputs[0]).output.keep_free == 1 << 30


@pytest.mark.parametrize(
    ("wrong", "answer"),
    [
        ("settle=0", "settle: input should be greater than or equal to 1, found 0"),
        ("settle=soon", "settle: .*found 'soon'"),
        ("attempts=0", "attempts: input should be greater"),
        ("keep.run=1", "keep.run: no such key; did you mean runs"),
        ("inputs=[]", "inputs: "),
        ("inputs=[{maps: x, eech: file}]", "inputs.0.eech: no such key; did you mean each"),
        ("inputs=[{maps: x, each: tree}]", "inputs.0.each: "),
        ("inputs=[{maps: x, settings: [neighbours.j=1]}]", "neighbours.j: no such key"),
        ("at='25:00'", "at: "),
        ("oputput=x", "oputput: no such key; did you mean output"),
    ],
)
def test_every_mistake_is_one_line(tmp_path, wrong, answer):
    with pytest.raises(ConfigurationError, match=answer) as error:
        load_nightly_settings(write(tmp_path), [wrong])
    assert "\n" not in str(error.value)


def test_a_misspelt_key_is_named_and_not_the_one_that_is_missing_for_it(tmp_path):
    path = tmp_path / "nightly.yaml"
    path.write_text("input: [{maps: x}]\noutput: out\n")
    with pytest.raises(ConfigurationError, match="input: no such key; did you mean inputs"):
        load_nightly_settings(path)


@pytest.mark.parametrize(("written", "read"), [("'02:00'", "02:00"), ("22:30", "22:30")])
def test_the_time_of_day_needs_no_quotes(tmp_path, written, read):
    settings = load_nightly_settings(write(tmp_path), [f"at={written}"])
    assert settings.at == read


def test_a_folder_of_several_maps_of_one_place_is_a_problem_and_no_map(tmp_path):
    for name in ("a/1.npy", "lio/GlobalMap.npy", "lio/SurfMap.npy"):
        (tmp_path / "in" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "in" / name).write_bytes(b"x")
    for each, names in (("folder", ["a"]), ("file", [])):
        text = f"inputs: [{{maps: in, each: {each}}}]\noutput: out\n"
        settings = load_nightly_settings(write(tmp_path, text))
        found, problems = find_maps(settings, [settings.configuration_of(settings.inputs[0])])
        assert [each.path.name for each in found] == names
        told = [problem.message for problem in problems]
        assert len(told) == len(names)
        assert all("several maps of one place (GlobalMap.npy, SurfMap.npy" in one for one in told)
    text = "inputs: [{maps: in/lio}]\noutput: out\n"
    settings = load_nightly_settings(write(tmp_path, text))
    found, problems = find_maps(settings, [settings.configuration_of(settings.inputs[0])])
    assert (len(found), problems) == (2, [])  # each is a map of its own
