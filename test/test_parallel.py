"""Work spread over the cores."""
from functools import partial
import math
from multiprocessing import get_context
import os
from pathlib import Path
import pickle
import signal
import subprocess
import sys
import time
from typing import Any

from parallel_work import divide, forked, has_imported, inner, one_dies, slow, threads_of_blas
import pytest

from hydro_twin import parallel
from hydro_twin.effects import EFFECTS, Placed
from hydro_twin.effects.curve import of_kind
from hydro_twin.errors import UserError, WorkerError
from hydro_twin.parallel import beside, in_processes
from hydro_twin.plants import PLANTS

CORES = len(os.sched_getaffinity(0))
several = pytest.mark.skipif(CORES < 2, reason='one core shares nothing')


@pytest.fixture(autouse=True)
def worth_it(monkeypatch):
    """Let any work be worth a worker."""
    monkeypatch.setattr(parallel, 'WORTH', 0.0)


def wait_for_workers():
    """Work until workers do, too."""
    end = time.monotonic() + 60.0
    while {pid for _, pid in in_processes(slow, range(8))} == {os.getpid()}:
        assert time.monotonic() < end


@several
def test_results_come_in_order_from_several_processes():
    wait_for_workers()
    results = list(in_processes(partial(slow, offset=10), range(12)))
    assert [value for value, _ in results] == list(range(10, 22))
    assert {pid for _, pid in results} > {os.getpid()}


@several
def test_a_worker_has_no_workers():
    """What is spread out again within an item is done where the item is."""
    wait_for_workers()
    results = list(in_processes(inner, range(6)))
    assert [count for count, _ in results] == [1] * 6
    assert len({pid for _, pid in results}) > 1


@several
def test_a_worker_has_one_thread_of_blas(monkeypatch):
    pool = parallel._Pool()
    monkeypatch.setattr(parallel, '_pool', pool)
    monkeypatch.setenv('OPENBLAS_NUM_THREADS', '3')
    try:
        wait_for_workers()
        results = list(in_processes(threads_of_blas, range(12)))
    finally:
        parallel._end()
    of_workers = [threads for threads, pid in results if pid != os.getpid()]
    assert of_workers
    assert all(threads == {1} for threads in of_workers)


@several
def test_workers_may_start_before_the_work(monkeypatch):
    pool = parallel._Pool()
    monkeypatch.setattr(parallel, '_pool', pool)
    monkeypatch.setattr(parallel, 'WORTH', math.inf)     # no work by itself starts any
    try:
        parallel.prepare('hydro_twin.inference.trace', 'wave')
        first = list(pool.workers)
        parallel.prepare('hydro_twin.inference.trace', 'wave')
        assert pool.workers == first
        assert len(first) == CORES - 1
        wait_for_workers()
    finally:
        parallel._end()


@several
def test_a_worker_with_nothing_to_do_imports_what_it_may_need(monkeypatch):
    pool = parallel._Pool()
    monkeypatch.setattr(parallel, '_pool', pool)
    try:
        parallel.prepare('json', 'wave')
        end = time.monotonic() + 60.0
        while {here for here, pid in in_processes(partial(has_imported, 'wave'), range(8))
               if pid != os.getpid()} != {True}:
            assert time.monotonic() < end
            time.sleep(2.0 * parallel.LULL)
    finally:
        parallel._end()


@several
def test_one_call_beside_the_caller():
    wait_for_workers()
    with beside(slow, 7) as result:
        time.sleep(1.0)
        value, pid = result()
    assert value == 7
    assert pid != os.getpid()


def test_what_no_worker_has_begun_is_done_by_the_caller(monkeypatch):
    monkeypatch.setattr(parallel, '_pool', parallel._Pool())
    here = os.getpid()
    with beside(slow, 7) as result:
        assert result() == (7, here)
    wait_for_workers()
    with beside(lambda k: (k, os.getpid()), 7) as result:
        assert result() == (7, here)


def test_an_error_beside_the_caller_is_raised_where_the_result_is_asked_for():
    with beside(divide, 0) as result, pytest.raises(ZeroDivisionError):
        result()
    with beside(divide, 0):
        pass


def test_an_error_comes_in_its_turn():
    results = in_processes(divide, [1, 2, 4, 0, 8])
    assert [next(results) for _ in range(3)] == [1.0, 0.5, 0.25]
    with pytest.raises(ZeroDivisionError):
        next(results)


@several
def test_calls_that_are_not_exhausted_block_no_other():
    wait_for_workers()
    first: Any = in_processes(slow, range(50))
    second = in_processes(partial(slow, offset=100), range(50))
    assert (next(first)[0], next(second)[0]) == (0, 100)
    assert [value for value, _ in in_processes(slow, range(10))] == list(range(10))
    first.close()
    assert [value for value, _ in second] == list(range(101, 150))


def test_closures_are_called_here():
    here = os.getpid()
    assert list(in_processes(lambda k: (k, os.getpid()), range(5))) == [
        (k, here) for k in range(5)]


@several
def test_a_worker_that_dies_is_one_line_and_the_next_call_has_others():
    wait_for_workers()
    with pytest.raises(WorkerError, match='worker process ended by itself') as error:
        list(in_processes(partial(one_dies, os.getpid()), range(50)))
    assert isinstance(error.value, UserError)
    wait_for_workers()


@several
@pytest.mark.filterwarnings('ignore:.*fork:DeprecationWarning')
def test_somebody_elses_fork_leaves_the_workers_alone():
    wait_for_workers()
    context = get_context('fork')
    queue = context.Queue()
    child = context.Process(target=forked, args=(queue,))
    child.start()
    assert [value for value, _ in queue.get(timeout=60)] == list(range(6))
    child.join()
    assert child.exitcode == 0
    assert len({pid for _, pid in in_processes(slow, range(12))}) > 1


def run(script, *options, **more):
    return subprocess.Popen([sys.executable, *options, script], stdout=subprocess.PIPE,
                            stderr=subprocess.PIPE, text=True, **more)


SCRIPT = """
import os, time
from hydro_twin import parallel
parallel.WORTH = 0.0
print('begins')
for _ in range(600):
    if len(set(parallel.in_processes(time.sleep, [0.02] * 8)) | set(map(
            os.path.basename, parallel.in_processes(os.readlink, ['/proc/self'] * 40)))) > 2:
        print('shared')
        break
print('ends', flush=True)
"""


@several
def test_a_script_without_a_guard_is_run_once(tmp_path):
    (tmp_path / 'script.py').write_text(SCRIPT)
    with run(tmp_path / 'script.py') as process:
        assert process.communicate(timeout=180) == ('begins\nshared\nends\n', '')


def children(pid):
    """List the processes that a process has begun."""
    found = Path(f'/proc/{pid}/task/{pid}/children').read_text()
    return [int(child) for child in found.split()]


def is_alive(pid):
    try:
        return Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()[0] != 'Z'
    except FileNotFoundError:
        return False


ENDLESS = """
import signal, time
from hydro_twin import parallel
signal.signal(signal.SIGINT, signal.default_int_handler)   # ignored if begun in the background
parallel.WORTH = 0.0
list(parallel.in_processes(time.sleep, [0.02] * 8))
print('begins', flush=True)
list(parallel.in_processes(time.sleep, [600.0] * 8))
"""


@several
@pytest.mark.parametrize('how', [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_workers_end_with_their_parent(tmp_path, how):
    """However it ends, amid an item: nobody waits for the end of its output for ever."""
    (tmp_path / 'script.py').write_text(ENDLESS)
    with run(tmp_path / 'script.py', start_new_session=True) as process:
        assert process.stdout.readline() == 'begins\n'
        workers = children(process.pid)
        assert len(workers) == min(CORES - 1, 7)
        if how == signal.SIGINT:
            os.killpg(process.pid, how)     # as a terminal does
        else:
            process.send_signal(how)
        _, errors = process.communicate(timeout=30)     # until none holds the pipes
    assert process.returncode == -how
    assert errors.count('Traceback') == (how == signal.SIGINT)
    # A worker closes its pipes while it ends, a moment before it is gone.
    until = time.monotonic() + 30.0
    while any(map(is_alive, workers)) and time.monotonic() < until:
        time.sleep(0.02)
    assert not any(map(is_alive, workers))


def test_effects_are_the_same_on_the_other_side():
    """Their laws are compiled: they go by name, not by value."""
    for effect in EFFECTS:
        assert pickle.loads(pickle.dumps(effect)) is effect
    for plant in PLANTS.values():
        assert pickle.loads(pickle.dumps(plant)) == plant
        port = plant.ports[-1]
        effect = of_kind(port.kind, 'value')
        placed = Placed(effect, port, (0.0,) * len(effect.parameters))
        assert pickle.loads(pickle.dumps(placed)) == placed
