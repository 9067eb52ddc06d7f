"""The benchmark of the engine, small: loops and Dask come to the same results."""
import re
import subprocess
import sys

import pytest


@pytest.mark.slow
def test_loops_and_workers_trace_the_same():
    pytest.importorskip('distributed')
    done = subprocess.run([sys.executable, '-m', 'benchmarks.fleet', '--traces', '2', '--rounds',
                           '1'], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert re.findall(r'^(\d \w+): [\d.]+ s a trace', done.stdout, re.MULTILINE) == [
        '1 shell', '1 loop', '1 worker', '2 shells', '2 loops', '2 workers']
