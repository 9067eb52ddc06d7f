"""What the tests of `parallel` have done in other processes; imports little."""
import os
import signal
import sys
import time

from hydro_twin.parallel import in_processes


def slow(k, offset=0):
    """Take long enough for a worker to have its share, wherever it has not."""
    time.sleep(0.02)
    return k + offset, os.getpid()


def inner(_):
    return len({pid for _, pid in in_processes(slow, range(4))}), os.getpid()


def threads_of_blas(_):
    """Return the numbers of threads that the libraries here have, and the process."""
    import scipy.linalg  # noqa: F401
    from threadpoolctl import threadpool_info

    time.sleep(0.02)
    return {pool['num_threads'] for pool in threadpool_info()}, os.getpid()


def has_imported(module, _):
    """Return whether the process has imported a module, and which it is."""
    time.sleep(0.02)
    return module in sys.modules, os.getpid()


def divide(k):
    time.sleep(0.02)
    return 1 / k


def one_dies(parent, k):
    """End the process, unless it is the parent."""
    if os.getpid() != parent:
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(0.02)


def forked(queue):
    queue.put(list(in_processes(slow, range(6))))
