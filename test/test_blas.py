"""Threads of BLAS: one where models are fitted, as many as before elsewhere."""
from contextlib import contextmanager
from threading import Thread

import pytest
import scipy.linalg  # noqa: F401, whose BLAS is another than numpy's
from threadpoolctl import threadpool_info, threadpool_limits

import hydro_twin as ht
from hydro_twin.blas import one_thread
from hydro_twin.inference.trace import trace
from hydro_twin.parallel import on_one_core
from hydro_twin.share import share_folder


def threads_of_blas():
    return {pool['num_threads'] for pool in threadpool_info() if pool['user_api'] == 'blas'}


@pytest.fixture(autouse=True)
def three():
    """Let BLAS have three threads, whatever the environment says."""
    with threadpool_limits(3, 'blas'):
        assert threads_of_blas() == {3}
        yield


@pytest.fixture(scope='module')
def data():
    return ht.read(share_folder() / 'bags' / 'valve_steps', 'valve_servo')


def test_one_thread_in_a_fit(data):
    seen = set()

    @contextmanager
    def show(what, total):
        seen.update(threads_of_blas())
        yield lambda: None

    ht.refit(data, ht.Request(), show=show)
    assert seen == {1}
    assert threads_of_blas() == {3}


def test_one_thread_in_a_trace_and_as_before_after_an_error(data):
    def progress(what):
        assert threads_of_blas() == {1}
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        trace(data.recording, None, data.plant, progress=progress)
    assert threads_of_blas() == {3}


def test_the_last_to_leave_resets():
    """Two notebooks' threads that fit at the same time share the one number."""
    first, second = one_thread(), one_thread()
    first.__enter__()
    thread = Thread(target=second.__enter__)
    thread.start()
    thread.join()
    first.__exit__(None, None, None)
    assert threads_of_blas() == {1}
    second.__exit__(None, None, None)
    assert threads_of_blas() == {3}


def test_one_thread_in_the_tasks_of_an_engine():
    with on_one_core():
        assert threads_of_blas() == {1}
    assert threads_of_blas() == {3}
