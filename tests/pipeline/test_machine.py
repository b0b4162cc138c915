"""What a process takes of the machine."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from pipeline.machine import peak_memory

MIB = 2**20


def test_the_peak_holds_what_was_given_back():
    before = peak_memory()
    taken = np.ones(before // 8 + 8 * MIB)  # more than all there was so far
    size = taken.nbytes
    del taken
    assert before + 32 * MIB < peak_memory() < before + size + 64 * MIB


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="the system has no /proc")
def test_a_small_program_started_by_a_large_one_is_small():
    large = np.ones(32 * MIB)  # 256 MiB
    program = "from pipeline.machine import peak_memory; print(peak_memory())"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, check=True)
    assert MIB < int(done.stdout) < 128 * MIB
    assert peak_memory() > large.nbytes
