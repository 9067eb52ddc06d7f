"""Work spread over the cores."""
import os
import signal
import subprocess
import sys

import pytest

from hydro_twin.fitting.parallel import in_processes, in_threads


def test_results_come_in_order_from_other_processes():
    """Closures are called elsewhere, where there are cores; results keep their order."""
    offset = 10
    results = list(in_processes(lambda k: (k + offset, os.getpid()), range(6)))
    assert [value for value, _ in results] == [10, 11, 12, 13, 14, 15]
    if len(os.sched_getaffinity(0)) > 1:
        assert os.getpid() not in {process for _, process in results}


def test_a_worker_has_no_workers():
    """What is spread out again within a worker is done there."""
    def inner(_):
        return len(set(in_processes(lambda _: os.getpid(), range(4))))

    assert list(in_processes(inner, range(2))) == [1, 1]


def test_errors_come_back():
    """What goes wrong in a worker is raised in its parent."""
    def divide(k):
        return 1 / k

    with pytest.raises(ZeroDivisionError):
        list(in_processes(divide, [1, 0]))
    with pytest.raises(ZeroDivisionError):
        in_threads(divide, [1, 0])


def test_workers_end_with_their_parent():
    """Whoever kills a command and waits for the end of its output does not wait for ever."""
    endless = """
import time
from hydro_twin.fitting.parallel import in_processes
def run(k):
    print(k, flush=True)
    time.sleep(30)
list(in_processes(run, range(4)))
"""
    with subprocess.Popen([sys.executable, '-c', endless], stdout=subprocess.PIPE) as process:
        process.stdout.readline()
        process.kill()
        process.communicate(timeout=20)     # until none holds the pipe
    assert process.returncode == -signal.SIGKILL
