"""Three packages, imports in one direction: pipeline may use tiling and dynahull, they nothing."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
FORBIDDEN = {
    "dynahull": {"tiling", "pipeline", "dask", "distributed", "laspy", "pyarrow", "open3d"},
    "tiling": {"dynahull", "pipeline", "dask", "distributed", "open3d"},
    "pipeline": {"benchmarks", "tests"},
}


RUNS_WHAT_IT_READS = {
    *("pickle", "_pickle", "cPickle", "marshal", "shelve", "dill", "cloudpickle", "joblib"),
    *("dbm", "copyreg"),
}
"""Modules that make objects of a file's bytes: who wrote the file decides what is called."""


def imported_packages(source: str) -> set[str]:
    names = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            names.add(node.module.partition(".")[0])
    return names


@pytest.mark.parametrize("package", FORBIDDEN)
def test_imports_go_one_way_only(package):
    modules = sorted((ROOT / package).rglob("*.py"))
    assert modules
    for module in modules:
        wrong = imported_packages(module.read_text(encoding="utf-8")) & FORBIDDEN[package]
        assert not wrong, f"{module.relative_to(ROOT)} imports {sorted(wrong)}"


def test_an_import_the_other_way_would_be_seen():
    source = "def f():\n    from pipeline.run import run\n    import dask.distributed\n"
    assert imported_packages(source) & FORBIDDEN["dynahull"] == {"pipeline", "dask"}


def calls_that_unpickle(source: str) -> list[str]:
    """Name the calls that make Python objects of what a file says."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.Call):
            continue
        name = ast.unparse(node.func)
        options = {option.arg: ast.unparse(option.value) for option in node.keywords}
        must_say = name in {"np.load", "np.save", "numpy.load", "numpy.save"}
        said = options.get("allow_pickle", "True" if must_say else "False")
        if said != "False" or name in {"yaml.load", "yaml.unsafe_load", "yaml.full_load"}:
            found.append(name)
    return found


@pytest.mark.parametrize("package", FORBIDDEN)
def test_nothing_on_a_disk_is_ever_unpickled(package):
    for module in sorted((ROOT / package).rglob("*.py")):
        source = module.read_text(encoding="utf-8")
        wrong = imported_packages(source) & RUNS_WHAT_IT_READS
        assert not wrong, f"{module.relative_to(ROOT)} imports {sorted(wrong)}"
        calls = calls_that_unpickle(source)
        assert not calls, f"{module.relative_to(ROOT)} calls {calls} that may unpickle"


def test_what_would_unpickle_is_seen():
    source = "np.load(p)\nnp.load(p, allow_pickle=True)\nx.y(allow_pickle=z)\nyaml.load(s, L)\n"
    assert len(calls_that_unpickle(source)) == 4
    assert calls_that_unpickle("np.load(p, allow_pickle=False)\njson.load(p)\n") == []
    source = "def f():\n    import pickle\n    from shelve import open\n"
    assert imported_packages(source) & RUNS_WHAT_IT_READS == {"pickle", "shelve"}


def test_nothing_imports_the_commands():
    """What a command does lies elsewhere, for whoever uses the packages from Python."""
    for module in sorted((ROOT / "pipeline").rglob("*.py")):
        inside = module.relative_to(ROOT / "pipeline").as_posix()
        if inside.startswith("commands/") or inside == "__main__.py":
            continue
        tree = ast.parse(module.read_text(encoding="utf-8"))
        wrong = [
            node.module
            for node in ast.walk(tree)
            if isinstance(node, ast.ImportFrom)
            and node.module
            and node.module.startswith("pipeline.commands")
        ]
        assert not wrong, f"{inside} imports {wrong}"
