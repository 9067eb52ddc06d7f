"""What is left in memory of traces that are done: nothing."""
from concurrent.futures import Executor, Future
from pathlib import Path
import subprocess
import sys
import weakref

from engine_work import held, kept_since, kill_or_square, on_from_here
from fleet_by_hand import record
import pytest

from hydro_twin.fleet.engine import dask_executor, work

KEPT = 1000             # bytes of a task, below the 3 kB that Dask would keep in its logs
PAYLOAD = 10_000        # bytes of a result
TRACES = """
import ctypes, gc, sys
from pathlib import Path
from fleet_by_hand import PLANT
from hydro_twin.fleet.manifest import Task
from hydro_twin.fleet.task import run

class Heap(ctypes.Structure):
    _fields_ = [(name, ctypes.c_size_t) for name in (
        'arena', 'ordblks', 'smblks', 'hblks', 'hblkhd', 'usmblks', 'fsmblks', 'uordblks',
        'fordblks', 'keepcost')]

mallinfo = ctypes.CDLL(None).mallinfo2
mallinfo.restype = Heap
folder = Path(sys.argv[1])
task = Task('a', PLANT, (folder / 'bag',), '', True, None, (), 'g', ())
for k in range(14):
    assert run(task, folder / str(k), 0).traced
    gc.collect()
    print(len(gc.get_objects()), sys.getallocatedblocks(), mallinfo().uordblks)
"""


def test_a_result_that_was_handed_on_is_let_go():
    """As long as a future is referred to, a worker of Dask keeps what came of it."""
    futures = []

    class AtOnce(Executor):
        """Does all at once."""

        def submit(self, function, /, *arguments, **_):
            future = Future()
            future.set_result(function(*arguments))
            futures.append(weakref.ref(future))
            return future

    count = 0
    for count, _ in enumerate(work(kill_or_square, range(5), AtOnce()), 1):
        assert sum(future() is not None for future in futures) <= 6 - count
    assert count == 5


@pytest.mark.slow
def test_a_worker_keeps_nothing_of_its_tasks():
    """Neither their results nor Dask's own record of them; its collector has less to look through.

    Python's own trace of memory counts what is kept of the second 200 tasks.
    """
    pytest.importorskip('distributed')
    with dask_executor('', 1, lambda _: None) as engine:
        list(work(held, [PAYLOAD] * 100, engine))
        engine.submit(on_from_here).result()
        list(work(held, [PAYLOAD] * 200, engine))
        kept, frozen = engine.submit(kept_since).result()
    assert kept < KEPT * 200
    assert frozen > 0


@pytest.mark.slow
def test_a_trace_leaves_nothing_behind(tmp_path):
    """From the ninth on, in a process of its own; a hundred or two of the blocks come and go.

    Before, imports and caches of a fixed size fill up: matplotlib keeps the last 50 formulas.
    The heap comes to rest only slowly: 5000 to 9000 B come to be used from the fifth trace to
    the sixth, less than 3000 from the tenth on.
    """
    record(tmp_path, 'bag', 1)
    process = subprocess.run([sys.executable, '-c', TRACES, tmp_path], capture_output=True,
                             text=True, check=True, cwd=Path(__file__).parent)
    ninth, *_, last = [tuple(map(int, line.split())) for line in
                       process.stdout.splitlines()[8:]]
    assert last[0] - ninth[0] < 5
    assert last[1] - ninth[1] < 500
    assert last[2] - ninth[2] < 30_000      # B, on the heap of C; formulas as ticks lose 50,000
