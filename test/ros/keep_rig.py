"""A rig as a process: a load simulator that publishes for ever, and begins to rub when told to.

    python keep_rig.py FASTER

publishes at FASTER times the real pace. It rubs from the first message (std_msgs/msg/Empty) on
/rub on. Made by the integrator of `simulate`, over one period of a periodic command, after another
has let it settle; so the periods follow each other without a jump.
"""
from __future__ import annotations

import sys
import time

import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Empty

from hydro_twin.live.writer import Writer
from hydro_twin.model import place
from hydro_twin.plants import plant_named
from hydro_twin.recording.series import Series
from hydro_twin.simulation.simulate import simulate

PLANT = plant_named('load_simulator')
VALUES = PLANT.constant_values() | {p.name: (p.lower * p.upper) ** 0.5 for p in PLANT.parameters}
PERIOD = 6.0      # [s]
STEP = 0.002      # [s]
NOISE = 0.5       # [N m]
COULOMB = 10.0    # [N m]
START = 1_700_000_000_000_000_000
LINES = (5, 9, 17, 31, 44, 61, 80)     # of the command, in periods


def period(*effects: tuple[str, str, dict[str, float]], seed: int = 0) -> Series:
    """Simulate two periods, and keep the second."""
    phase = np.random.default_rng(seed).uniform(0, 2 * np.pi, len(LINES))

    def command(t):
        held = np.floor(t / STEP + 1e-6) * STEP
        return 0.1 * np.sum(np.sin(2 * np.pi * np.outer(held, LINES) / PERIOD + phase), axis=1)

    def shaft(t):
        return 0.02 * np.sin(2 * np.pi * 8 * t / PERIOD)

    placed = [place(*effect, PLANT) for effect in effects]
    series = simulate(PLANT, VALUES, placed, {'u_m': command, 'theta_d': shaft}, 2.0 * PERIOD)
    count = round(PERIOD / STEP)
    return Series({name: column[count:2 * count] for name, column in series.columns.items()},
                  STEP, START)


def main(faster: float) -> None:
    """Publish until interrupted."""
    healthy, worn = period(), period(('friction', 'motor', {'coulomb': COULOMB}))
    rclpy.init()
    node = rclpy.create_node('rig')
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    qos = QoSProfile(depth=20_000)
    command, state = (node.create_publisher(JointState, f'/load_simulator/{name}', qos)
                      for name in ('command', 'joint_states'))
    rubs: list[Empty] = []
    node.create_subscription(Empty, '/rub', rubs.append, 10)
    rng = np.random.default_rng(1)
    valve = Writer(['valve'], 'rad')
    joint = JointState(name=['shaft'], position=[0.0], effort=[0.0])
    begin, k, count = time.monotonic(), 0, len(healthy)
    while True:
        due = int((time.monotonic() - begin) * faster / STEP)
        while k < due:
            one, stamp, at = worn if rubs else healthy, START + round(k * STEP * 1e9), k % count
            command.publish(valve.write(stamp, float(one['u_m'][at])))
            joint.header.stamp.sec, joint.header.stamp.nanosec = divmod(stamp, 1_000_000_000)
            joint.position[0] = float(one['theta_d'][at])
            joint.effort[0] = float(one['T_g'][at] + NOISE * rng.standard_normal())
            state.publish(joint)
            k += 1
        executor.spin_once(timeout_sec=0.005)


if __name__ == '__main__':
    try:
        main(float(sys.argv[1]))
    except KeyboardInterrupt:
        rclpy.try_shutdown()
