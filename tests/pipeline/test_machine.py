"""What a process takes of the machine."""

import subprocess
import sys

import numpy as np
import pytest

from pipeline.plan.machine import peak_memory, peak_of_workers

MIB = 2**20


def test_the_peak_holds_what_was_given_back():
    before = peak_memory()
    taken = np.ones(before // 8 + 8 * MIB)  # more than all there was so far
    size = taken.nbytes
    del taken
    assert before + 32 * MIB < peak_memory() < before + size + 64 * MIB


@pytest.mark.linux_only
def test_a_small_program_started_by_a_large_one_is_small():
    large = np.ones(32 * MIB)  # 256 MiB
    program = "from pipeline.plan.machine import peak_memory; print(peak_memory())"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, check=True)
    assert MIB < int(done.stdout) < 128 * MIB
    assert peak_memory() > large.nbytes


GIVEN_BACK = """
import sys
from pathlib import Path
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from pipeline.plan.machine import give_memory_back

def held():
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("RssAnon"))

def use(count):
    table = pa.table({"x": pa.array(np.random.default_rng(0).uniform(size=count))})
    pq.write_table(table, sys.argv[1], compression="zstd", use_dictionary=False)
    table = pq.ParquetFile(sys.argv[1]).read(use_threads=False)

use(1_000)  # what is imported stays
give_memory_back()
before = held()
use(4_000_000)
kept = held()
give_memory_back()
print(before, kept, held())
"""


@pytest.mark.linux_only
def test_what_arrow_keeps_is_given_back(tmp_path):
    program = [sys.executable, "-c", GIVEN_BACK, str(tmp_path / "table.parquet")]
    done = subprocess.run(program, capture_output=True, check=True)
    before, kept, after = map(int, done.stdout.split())
    assert kept > before + 24 * 1024
    assert after < before + 8 * 1024


def test_the_peak_of_a_process_that_was_started_is_known():
    before = peak_of_workers()
    program = f"held = bytearray({before} + 80_000_000); held[::4096] = b'x' * len(held[::4096])"
    subprocess.run([sys.executable, "-c", program], check=True)
    assert peak_of_workers() > before + 80_000_000
