"""Replay against real time, and a live step against one rclpy publish.

    python benchmarks/replay.py [--minutes 10]

All ratios are of one run on one machine, after compilation.
"""
from __future__ import annotations

import argparse
from pathlib import Path
import subprocess
import sys
import tempfile
import time

import numpy as np

from hydro_twin.model import Model, place
from hydro_twin.plants import PLANTS
from hydro_twin.predictors.analytical import Analytical
from hydro_twin.recording.rig import read, rig_of
from hydro_twin.recording.series import Series
from hydro_twin.recording.write import write_recording

PLANT = PLANTS['load_simulator']
STEPS = 20000


def model(*effects):
    placed = tuple(place(name, port, values, PLANT) for name, port, values in effects)
    return Model(PLANT, PLANT.constant_values() | PLANT.middle(), PLANT.sample_time, placed)


MODELS = {
    'linear': model(),
    'friction': model(('friction', 'motor', {'coulomb': 10.0})),
    'friction and dead zone': model(('friction', 'motor', {'coulomb': 10.0}),
                                    ('dead_zone', 'spool', {'width': 3e-6})),
}


def recording(minutes):
    t = 0.002 * np.arange(round(minutes * 60 / 0.002))
    rng = np.random.default_rng(0)
    return Series({'u_m': 0.3 * np.sin(2 * np.pi * 7 * t), 'theta_d': 0.01 * np.sin(3 * t),
                   'T_g': 50 * np.sin(2 * np.pi * 7 * t) + rng.normal(size=len(t))}, 0.002, 10**12)


def seconds(function, repeats=5):
    best = np.inf
    for _ in range(repeats):
        begin = time.perf_counter()
        function()
        best = min(best, time.perf_counter() - begin)
    return best


def offline(minutes):
    rig = rig_of(PLANT)
    with tempfile.TemporaryDirectory() as folder:
        for suffix in ('mcap', 'db3'):
            bag = Path(folder) / f'bag.{suffix}'
            write_recording(bag, [recording(minutes)], rig.signals)
            series = read([bag], rig).series[0]
            reading = seconds(lambda bag=bag: read([bag], rig), 3)
            print(f'{suffix}: reading {reading:.2f} s for {len(series)} samples')
            for name, one in MODELS.items():
                predictor = Analytical(one)
                predictor.free_run(series.part(0, 100))
                run = seconds(lambda p=predictor, s=series: p.free_run(s), 3)
                real = minutes * 60
                print(f'  {name}: {real / (run + reading):.0f} times real time with the reading, '
                      f'{real / run:.0f} without')


def live():
    """Cost of one step, sample by sample, in microseconds."""
    series = recording(STEPS * 0.002 / 60)
    inputs = np.column_stack([series['u_m'], series['theta_d']])
    measured = series['T_g'].tolist()
    costs = {}
    for name, one in MODELS.items():
        for mode in ('one_step', 'free_run'):
            stepper = Analytical(one).stepper(mode)
            stepper.step(inputs[0], measured[0])
            begin = time.perf_counter()
            for u, y in zip(inputs, measured, strict=True):
                stepper.step(u, y)
            costs[f'{name}, {mode}'] = (time.perf_counter() - begin) / STEPS * 1e6
    return costs


def publishing():
    """Cost of one publish of a JointState to a subscriber in another process, in microseconds."""
    try:
        import rclpy
        from rclpy.qos import QoSProfile
        from sensor_msgs.msg import JointState
    except ImportError:
        return None
    rclpy.init(args=[])
    node = rclpy.create_node('publisher')
    publisher = node.create_publisher(JointState, 'prediction', QoSProfile(depth=10))
    listen = ('import rclpy; from sensor_msgs.msg import JointState; rclpy.init(); '
              'n = rclpy.create_node("listener"); '
              'n.create_subscription(JointState, "prediction", lambda m: None, 10); '
              'rclpy.spin(n)')
    with subprocess.Popen([sys.executable, '-c', listen], stderr=subprocess.DEVNULL) as listener:
        while not publisher.get_subscription_count():
            time.sleep(0.05)
        message = JointState(name=['motor'], effort=[1.0])
        spent = []
        for _ in range(2000):
            time.sleep(0.002)
            begin = time.perf_counter()
            publisher.publish(message)
            spent.append(time.perf_counter() - begin)
        listener.terminate()
    node.destroy_node()
    rclpy.try_shutdown()
    return float(np.median(spent)) * 1e6


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--minutes', type=float, default=10.0)
    minutes = parser.parse_args().minutes
    offline(minutes)
    publish = publishing()
    if publish is not None:
        print(f'one publish of a JointState at 500 Hz: {publish:.1f} us (median)')
    for name, cost in live().items():
        ratio = '' if publish is None else f', {cost / publish:.3f} of a publish'
        print(f'one live step, {name}: {cost:.2f} us{ratio}')


if __name__ == '__main__':
    main()
