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
