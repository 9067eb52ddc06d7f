"""A load simulator as a process that wears, for demonstrations and tests of `keep`.

    python -m hydro_twin.ros.worn_rig [--faster 3] [--at 120 360] [--model first.yaml]

It publishes for ever, rubs from the first time on, and has play in its coupling besides from the
second; a message (std_msgs/msg/Empty) on /wear takes it to the next stage at once. With --model
it first writes the model of the rig as made. The motion is that of the integrator of `simulate`,
which shares nothing with the models but the laws: of each stage one period under a periodic
command, after another has let it settle, so that the periods follow each other without a jump.
The noise of the sensor is fresh.
"""
from __future__ import annotations

import argparse
from collections.abc import Sequence
import math
from pathlib import Path
import time

import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Empty

from hydro_twin.arrays import FloatArray
from hydro_twin.live.writer import Writer
from hydro_twin.model import Model, place, Record, Uncertainty, write_model
from hydro_twin.plants import plant_named
from hydro_twin.recording.series import Series
from hydro_twin.simulation.simulate import simulate

PLANT = plant_named('load_simulator')
VALUES = PLANT.constant_values() | {p.name: (p.lower * p.upper) ** 0.5 for p in PLANT.parameters}
STEP = 0.002      # [s]
PERIOD = 6.0      # [s]
NOISE = 0.5       # RMS of the sensor [N m]
LINES = (5, 9, 17, 31, 44, 61, 80)     # of the command, in periods
COMMAND = 0.1     # amplitude of each [V]
SHAFT = 0.02, 8   # amplitude of the shaft [rad], and its line
COULOMB = 10.0    # friction [N m]
GAP = 1e-3        # half of the play [rad]
FRICTION = ('friction', 'motor', {'coulomb': COULOMB})
STAGES = ((), (FRICTION,), (FRICTION, ('backlash', 'coupling', {'gap': GAP})))
START = 1_700_000_000_000_000_000


def first_model(path: Path) -> Path:
    """Write the model of the rig as it was made; its errors are made up, and small."""
    uncertainty = {p.name: Uncertainty(std_error=0.01 * VALUES[p.name]) for p in PLANT.parameters}
    write_model(Model(PLANT, VALUES, STEP, record=Record(
        uncertainty, {'after': {'free_run': {'test': NOISE}}})), path)
    return path


def period(stage: int) -> Series:
    """Simulate two periods of a stage, without noise, and keep the second."""
    phase = np.random.default_rng(0).uniform(0, 2 * np.pi, len(LINES))

    def command(t: FloatArray) -> FloatArray:
        held = np.floor(t / STEP + 1e-6) * STEP
        return np.asarray(COMMAND * np.sum(
            np.sin(2 * np.pi * np.outer(held, LINES) / PERIOD + phase), axis=1))

    def shaft(t: FloatArray) -> FloatArray:
        return np.asarray(SHAFT[0] * np.sin(2 * np.pi * SHAFT[1] * t / PERIOD))

    placed = [place(*effect, PLANT) for effect in STAGES[stage]]
    series = simulate(PLANT, VALUES, placed, {'u_m': command, 'theta_d': shaft}, 2.0 * PERIOD)
    count = round(PERIOD / STEP)
    return Series({name: column[count:2 * count] for name, column in series.columns.items()},
                  STEP, START)


def publish(faster: float, times: Sequence[float]) -> None:
    """Publish until interrupted.

    Args:
        faster: than real time.
        times: at which each stage but the first begins, of the rig [s].
    """
    stages = [period(k) for k in range(len(STAGES))]
    begins = [*times, *[math.inf] * (len(STAGES) - 1 - len(times))]
    rclpy.init()
    node = rclpy.create_node('rig')
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    qos = QoSProfile(depth=20_000)
    command, state = (node.create_publisher(JointState, f'/load_simulator/{name}', qos)
                      for name in ('command', 'joint_states'))
    asked: list[Empty] = []
    node.create_subscription(Empty, '/wear', asked.append, 10)
    rng = np.random.default_rng(1)
    valve = Writer(['valve'], 'rad')
    joint = JointState(name=['shaft'], position=[0.0], effort=[0.0])
    begin, k, count = time.monotonic(), 0, len(stages[0])
    while True:
        due = int((time.monotonic() - begin) * faster / STEP)
        while k < due:
            stage = max(sum(k * STEP >= one for one in begins), min(len(asked), len(STAGES) - 1))
            one, stamp, at = stages[stage], START + round(k * STEP * 1e9), k % count
            command.publish(valve.write(stamp, float(one['u_m'][at])))
            joint.header.stamp.sec, joint.header.stamp.nanosec = divmod(stamp, 1_000_000_000)
            joint.position[0] = float(one['theta_d'][at])
            joint.effort[0] = float(one['T_g'][at] + NOISE * rng.standard_normal())
            state.publish(joint)
            k += 1
        executor.spin_once(timeout_sec=0.005)


def main(arguments: Sequence[str] | None = None) -> None:
    """Publish until interrupted."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    parser.add_argument('--faster', type=float, default=1.0, help='than real time (default: 1)')
    parser.add_argument('--at', type=float, nargs='*', default=[],
                        help='when it begins to rub, and to have play [s]')
    parser.add_argument('--model', type=Path, help='a model file to write first')
    args, _ = parser.parse_known_args(arguments)        # launch adds arguments of ROS
    if len(args.at) >= len(STAGES):
        parser.error('--at takes at most two times')
    if args.model:
        first_model(args.model)
    try:
        publish(args.faster, args.at)
    except (KeyboardInterrupt, ExternalShutdownException):
        rclpy.try_shutdown()


if __name__ == '__main__':
    main()
