"""How long a trace of a long bag takes, and how much memory: the whole command, from bag to page.

    python benchmarks/hour.py [--hours 1]

makes a load simulator's bag at 500 Hz with dry friction and noise (by the predictor's own
arithmetic: this is about time, not about names), traces it in a process of its own, and prints
seconds, peak memory and what was named.
"""
from __future__ import annotations

import argparse
import json
import os
from pathlib import Path
import subprocess
import sys
import tempfile
import time

import numpy as np

from hydro_twin.model import Model, place
from hydro_twin.plants.load_simulator import LOAD_SIMULATOR as PLANT
from hydro_twin.recording.series import Series
from hydro_twin.recording.signals import load_signals
from hydro_twin.recording.write import write_recording


def make_bag(path: Path, hours: float) -> None:
    """Write a recording under three sinusoids, with the shaft moving, and noise of 0.5 N m."""
    samples = round(hours * 3600.0 / PLANT.sample_time)
    t = PLANT.sample_time * np.arange(samples)
    u_m = sum(np.sin(2.0 * np.pi * f * t + f) for f in (1.03, 7.1, 9.07))
    theta_d = 0.02 * np.sin(2.0 * np.pi * 0.71 * t)
    values = {p.name: (p.lower * p.upper) ** 0.5 for p in PLANT.parameters}
    rig = Model(PLANT, {**PLANT.constant_values(), **values}, PLANT.sample_time,
                (place('friction', 'motor', {'coulomb': 10.0}, PLANT),), substeps=2).system
    inputs = np.column_stack([u_m, theta_d])
    T_g = rig.run(inputs, rig.start(inputs[0], 0.0))
    T_g += 0.5 * np.random.default_rng(0).standard_normal(samples)
    signals = load_signals(PLANT.name, [signal.name for signal in PLANT.signals])
    write_recording(path, [Series({'u_m': u_m, 'theta_d': theta_d, 'T_g': T_g},
                                  PLANT.sample_time, 0)], signals)


def main() -> None:
    """Make the bag, trace it, and print one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--hours', type=float, default=1.0)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / 'bag'
        make_bag(bag, args.hours)
        begin = time.monotonic()
        with subprocess.Popen(
                [sys.executable, '-m', 'hydro_twin.commands.main', 'trace', str(bag), '--plant',
                 PLANT.name, '-o', str(Path(folder) / 'out'), '--json'],
                stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as process:
            assert process.stdout is not None
            report = json.loads(process.stdout.read())
            _, status, usage = os.wait4(process.pid, 0)
            process.returncode = os.waitstatus_to_exitcode(status)
        print(json.dumps({
            'samples': round(args.hours * 3600.0 / PLANT.sample_time),
            'seconds': round(time.monotonic() - begin, 1),
            'of processor': round(usage.ru_utime + usage.ru_stime, 1),
            'peak_gib': round(usage.ru_maxrss / 2**20, 2),
            'named': [effect['id'] for effect in report['effects']]}))


if __name__ == '__main__':
    main()
