"""What the tests of the engine have done in other processes; imports little."""
import gc
import os
import signal
import tracemalloc


def kill_or_square(item):
    if item == 'dies':
        os.kill(os.getpid(), signal.SIGKILL)
    if item == 'raises':
        raise ValueError('no\nsquare')
    return item * item


def held(size):
    return bytes(size)


def on_from_here():
    """Count memory from here on; what is garbage is not counted."""
    gc.collect()
    tracemalloc.start()


def kept_since():
    """Return the bytes that have been allocated since and not been freed, and objects frozen."""
    gc.collect()
    return tracemalloc.get_traced_memory()[0], gc.get_freeze_count()
