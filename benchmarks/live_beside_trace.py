"""Latency of the live twin while a trace of `keep` runs, against without.

    python -m benchmarks.live_beside_trace [--seconds 20] [--repeat 3]

The twin is driven at 500 Hz as in live.py; without and with a trace of a sample bag, confined as
`keep` does it, in turns. On a busy machine it says nothing.
"""
from __future__ import annotations

import argparse
from collections.abc import Iterator
import contextlib
import json
import os
from pathlib import Path
import shlex
import signal
import subprocess
import sys
import tempfile

import numpy as np
import rclpy

from benchmarks.live import Driver, make_models, running, twin
from hydro_twin.keep.settings import SETTINGS
from hydro_twin.keep.tracing import MIB, other_cores
from hydro_twin.share import share_folder

LIMITS = {setting.name: setting.default for setting in SETTINGS}


@contextlib.contextmanager
def tracing(folder: Path) -> Iterator[None]:
    """Trace for as long as it is needed, one bag after another, within the limits of `keep`."""
    spec = json.dumps({'nice': LIMITS['nice'], 'cores': other_cores(),
                       'memory': int(float(str(LIMITS['trace_memory']))) * MIB})
    words = shlex.join([
        sys.executable, '-m', 'hydro_twin.keep.confined', spec, 'trace',
        str(share_folder() / 'bags' / 'rig_a'), '--plant', 'load_simulator', '-o',
        str(folder / 'out')])
    with subprocess.Popen(['sh', '-c', f'while {words}; do :; done'], stdout=subprocess.DEVNULL,
                          stderr=subprocess.DEVNULL, start_new_session=True) as loop:
        try:
            yield
        finally:
            os.killpg(loop.pid, signal.SIGKILL)


def main() -> None:
    """Measure, and print one JSON object a line, the ratio last."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    parser.add_argument('--seconds', type=float, default=20.0)
    parser.add_argument('--repeat', type=int, default=3)
    args = parser.parse_args()
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    os.environ.setdefault('ROS_DOMAIN_ID', '101')   # the tests take others
    rclpy.init()
    driver, found = Driver(), {'without': [], 'with': []}
    with tempfile.TemporaryDirectory() as folder:
        model = make_models(Path(folder))['linear']
        for _ in range(args.repeat):
            for case, beside in (('without', contextlib.nullcontext()),
                                 ('with', tracing(Path(folder)))):
                with beside, running(twin(model)) as process:
                    figures = driver.drive(process.pid, 500.0, args.seconds)
                found[case].append(figures['p99_us'])
                print(json.dumps({'case': case, 'load': os.getloadavg()[0], **figures}),
                      flush=True)
    print(json.dumps({'p99_with_against_without': round(float(
        np.median(found['with']) / np.median(found['without'])), 3)}))
    rclpy.try_shutdown()
    driver.thread.join()


if __name__ == '__main__':
    main()
