"""A short campaign of attacks; `python -m benchmarks.attack` is a long one."""

import errno
import random
import shutil
from collections import Counter

import numpy as np
import pytest

from benchmarks import attack
from pipeline.configuration.run import load_configuration
from pipeline.errors import PipelineError
from pipeline.progress import LogDisplay, StageObserver
from pipeline.run import run


def test_no_attack_does_harm(tmp_path, capsys):
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


FAILURES = 30


def test_thirty_writes_that_fail_leave_results_whole_or_absent(tmp_path, monkeypatch):
    """In this process, so that they cost little; the campaign has runs of their own."""
    monkeypatch.setattr("os.fsync", lambda handle: None)
    points = np.random.default_rng(3).uniform(size=(500, 3)) * [9, 7, 2]
    np.save(tmp_path / "map.npy", points)
    digest = attack.digest_of(tmp_path / "map.npy")
    settings = [
        "neighbours.k=8",
        "clustering.count=2",
        "ground.method=none",
        "tiling.halo=0.3",
        "tiling.max_points=150",
        "execution.cluster=none",
        "output.report=none",
    ]
    configuration = load_configuration("paper", settings)

    def cleaned(fault):
        with attack.Calls(fault) as calls:
            run(
                [tmp_path / "map.npy"], tmp_path / "out", configuration, StageObserver(LogDisplay())
            )
        return calls.seen

    def results():
        names = ("static.npy", "dynamic.npy")
        return {
            n: (tmp_path / "out" / n).read_bytes() for n in names if (tmp_path / "out" / n).exists()
        }

    calls = cleaned(attack.Fault())
    expected, ended = results(), Counter()
    chance = random.Random(1)
    for number in range(FAILURES):
        earlier = number % 3 == 0
        if not earlier:
            shutil.rmtree(tmp_path / "out", ignore_errors=True)
        call = 1 + number * calls // FAILURES + chance.randrange(calls // FAILURES)
        code = chance.choice([errno.ENOSPC, errno.EIO])
        try:
            cleaned(attack.Fault(call, code))
            ended["well"] += 1
            assert results() == expected
        except (OSError, PipelineError) as error:
            ended["one line"] += 1
            assert str(error).isprintable()
            assert results() in ((expected,) if earlier else ({}, expected))
            cleaned(attack.Fault())
            assert results() == expected
    assert ended["one line"] >= 5  # tasks that fail are tried again
    assert attack.digest_of(tmp_path / "map.npy") == digest
