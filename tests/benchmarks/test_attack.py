"""A short campaign of attacks; `python -m benchmarks.attack` is a long one."""

import importlib
from pathlib import Path

import numpy as np
import pytest


def test_no_attack_does_harm(tmp_path, monkeypatch, capsys):
    monkeypatch.syspath_prepend(str(Path(__file__).resolve().parents[2]))
    attack = importlib.import_module("benchmarks.attack")
    points = np.random.default_rng(3).uniform(size=(800, 3)) * [9, 7, 2]
    np.save(tmp_path / "map.npy", points)
    settings = (
        "neighbours.k=8",
        "clustering.count=2",
        "ground.method=none",
        "tiling.halo=0.3",
        "output.report=none",
    )
    wanted = [word for each in settings for word in ("--set", each)]
    with pytest.raises(SystemExit) as ended:
        attack.main(
            [
                str(tmp_path / "map.npy"),
                "--rounds",
                "3",
                "--seed",
                "1",
                "--max-points",
                "200",
                *wanted,
            ]
        )
    told = capsys.readouterr().out
    assert ended.value.code == 0, told
    assert "no harm" in told
    assert "damage: " in told
    assert "failed, one line" in told
