"""Forks writers to a store, kills each at a random moment, and reads the store after each.

Run as a process of its own, which has no threads, so that it may fork:
    python killed_writer.py STORE MODEL KILLS
Prints for each kill the versions and the champion that it read, as JSON; goes on until some
versions were written.
"""
from __future__ import annotations

from contextlib import suppress
from itertools import count
import json
import os
from pathlib import Path
import random
import signal
import sys
import time

from hydro_twin.store.store import Store
from hydro_twin.store.version import StoreError


def write_for_ever(store, model, seed):
    """Enter, promote, discard and go back, in a random order."""
    rng = random.Random(seed)
    while True:
        name = store.enter(model, 'the writer', as_challenger=rng.random() < 0.5).name
        with suppress(StoreError):
            match rng.randrange(3):
                case 0:
                    store.promote(name, 'the writer')
                case 1:
                    store.decide(name, 'discarded', 'the writer')
                case _:
                    store.roll_back('the writer')


def main(folder, model, kills):
    """Do it."""
    store, rng, names = Store(Path(folder)), random.Random(1), []
    for k in count():
        if k >= int(kills) and len(names) > 10:     # a busy machine writes few between two kills
            return
        child = os.fork()
        if not child:
            write_for_ever(store, Path(model), k)
        end = time.monotonic() + rng.uniform(0.02, 0.4) * (1.0 + k / 15.0)
        while time.monotonic() < end:      # a reader beside the writer
            store.versions()
            assert store.champion is None or store.champion.model_file.is_file()
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        names = [version.name for version in store.versions()]
        for version in store.versions()[-2:]:
            version.model()
        champion = store.champion
        print(json.dumps([names, champion.name if champion else None]), flush=True)


if __name__ == '__main__':
    main(*sys.argv[1:])
