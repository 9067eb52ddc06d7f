"""What the tests of the engine have done in other processes; imports little."""
import os
import signal


def kill_or_square(item):
    if item == 'dies':
        os.kill(os.getpid(), signal.SIGKILL)
    if item == 'raises':
        raise ValueError('no\nsquare')
    return item * item
