"""Files that hand the program on say what it says of itself; what builds them runs elsewhere."""

import re
import tomllib
from fnmatch import fnmatch
from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
ELSEWHERE = {"dask": "dask-core"}


def test_the_conda_recipe_asks_for_what_the_project_asks_for():
    recipe = yaml.safe_load((ROOT / "packaging/conda/recipe.yaml").read_text())
    assert recipe["package"] == {"name": PROJECT["name"], "version": PROJECT["version"]}
    (script,) = recipe["build"]["python"]["entry_points"]
    assert script == f"{PROJECT['name']} = {PROJECT['scripts'][PROJECT['name']]}"
    wanted = {f"python {PROJECT['requires-python']}", "lazrs-python", "laszip-python"}
    for requirement in PROJECT["dependencies"]:
        name, bound = re.fullmatch(r"([\w-]+)(?:\[.*\])?(>=.*)", requirement).groups()
        wanted.add(f"{ELSEWHERE.get(name.lower(), name.lower())} {bound}")
    assert set(recipe["requirements"]["run"]) == wanted


def test_the_workflow_runs_what_is_run_here():
    workflow = yaml.safe_load((ROOT / ".github/workflows/ci.yaml").read_text())
    commands = [
        [step["run"] for step in job["steps"] if "run" in step] for job in workflow["jobs"].values()
    ]
    assert commands == [[".ci/run"], [".ci/run"], [".ci/lowest"], [".ci/attack"]]
    assert workflow["jobs"]["newest"]["env"] == {"PIP_CONSTRAINT": ""}
    matrix = workflow["jobs"]["all"]["strategy"]["matrix"]
    assert all(f"Programming Language :: Python :: {each}" in PROJECT["classifiers"]
               for each in matrix["python"])  # fmt: skip


def test_the_image_starts_the_program():
    text = (ROOT / "packaging/Dockerfile").read_text()
    assert f'ENTRYPOINT ["{PROJECT["name"]}"]' in text


def test_what_the_readme_makes_is_not_in_the_image():
    left_out = (ROOT / ".dockerignore").read_text().splitlines()
    made = re.search(r"python3 -m venv (\S+) .* simulate .* run (\w+)/map.pcd .* evaluate (\w+) ",
                     (ROOT / "README.md").read_text())  # fmt: skip
    for name in (".git", *made.groups()):
        assert any(fnmatch(name, pattern) for pattern in left_out), name
    for kept in ("pyproject.toml", "dynahull", "pipeline", "tiling", "configs", "README.md"):
        assert not any(fnmatch(kept, pattern) for pattern in left_out), kept


def test_the_version_is_in_the_changelog():
    text = (ROOT / "CHANGELOG.md").read_text()
    assert f"## [{PROJECT['version']}]" in text
