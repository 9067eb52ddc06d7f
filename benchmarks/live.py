"""The live twin against a bare rclpy node that copies its inputs to outputs, over DDS.

    python benchmarks/live.py [--seconds 10] [--only NAME...]

Two processes each time: this one drives (a command and a joint state a sample, as a rig does) and
listens; the other is the bare node or the twin. Both take as many messages and publish as many,
both spin the same executor. Latency is from the publishing of the joint state to the arrival of
the message with its stamp. CPU figures are of the other process.
"""
from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
import contextlib
from dataclasses import replace
import json
import os
from pathlib import Path
import signal
import subprocess
import sys
import tempfile
import threading
import time

import numpy as np
from rcl_interfaces.srv import SetParameters
import rclpy
from rclpy.executors import Executor, ExternalShutdownException
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

from hydro_twin.live.diagnostics import Diagnosis
from hydro_twin.live.inputs import TwinInputs
from hydro_twin.live.models import Choice, load_twin
from hydro_twin.live.outlet import Outlet
from hydro_twin.live.reader import Reader
from hydro_twin.live.writer import Writer
from hydro_twin.model import Model, Noise, place, read_model, Record, write_model
from hydro_twin.plants import plant_named
from hydro_twin.predictors.network import Network, network_bytes
from hydro_twin.recording.signals import load_signals, SignalMap
from hydro_twin.ros.spin import make_executor

PLANT = plant_named('load_simulator')
COMMAND, JOINTS = '/load_simulator/command', '/load_simulator/joint_states'
BEST_EFFORT = QoSProfile(depth=200, reliability=ReliabilityPolicy.BEST_EFFORT)
SETTLE = 2.0   # s before anything is counted
TICKS = os.sysconf('SC_CLK_TCK')


def bare() -> None:
    """Copy each input to an output, and do nothing else."""
    rclpy.init()
    node = Node('bare')
    for topic, copy in ((COMMAND, 'copy'), (JOINTS, '/hydro_twin/prediction')):
        publisher = node.create_publisher(JointState, copy, QoSProfile(depth=200))
        node.create_subscription(JointState, topic, publisher.publish, BEST_EFFORT)
    executor = make_executor()
    executor.add_node(node)
    with contextlib.suppress(KeyboardInterrupt):
        while rclpy.ok():
            executor.spin_once(timeout_sec=0.2)


def make_models(folder: Path) -> dict[str, Path]:
    """Write the models that are compared: linear, with two effects, hybrid 14-80-1."""
    values = PLANT.constant_values() | PLANT.middle()
    effects = (place('friction', 'motor', {'coulomb': 10.0}, PLANT),
               place('dead_zone', 'spool', {'centre': 0.0, 'width': 3e-6}, PLANT))
    rng = np.random.default_rng(0)
    network = Network(np.array([14, 80, 1]), rng.normal(0, 0.01, 15 * 80 + 81), np.zeros(14),
                      np.full(14, 30.0), 1.0, 1e4)
    (folder / 'hybrid.safetensors').write_bytes(network_bytes(network))
    errors = {'after': {mode: {'test': 1.0} for mode in ('one_step', 'free_run')}}
    paths = {}
    for name, more in {'linear': {}, 'two effects': {'effects': effects},
                       'hybrid': {'kind': 'hybrid', 'network': 'hybrid.safetensors'}}.items():
        paths[name] = folder / f'{name.replace(" ", "_")}.yaml'
        write_model(Model(PLANT, values, 0.002, record=Record(errors=errors), **more),
                    paths[name])
    return paths


def observed(path: Path) -> Path:
    """Write a model once more with its noise, for the observer."""
    model = read_model(path)
    record = replace(model.record, errors={'after': {'observer': {'test': 20.0}}})
    noise = Noise(10.0, {'x_v': 1e-8, 'p_L': 1e3, 'omega_j': 1e-2},
                  {'x_v': 1e-6, 'p_L': 1e5, 'omega_j': 0.1, 'theta_j': 1e-3})
    there = path.with_name(f'observed_{path.name}')
    write_model(replace(model, noise=noise, record=record), there)
    return there


@contextlib.contextmanager
def running(command: Sequence[str]) -> Iterator[subprocess.Popen[bytes]]:
    """Run the other process."""
    with subprocess.Popen([sys.executable, *command], stderr=subprocess.DEVNULL) as process:
        try:
            yield process
        finally:
            process.send_signal(signal.SIGINT)
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                process.kill()


def cpu(pid: int) -> float:
    """CPU time of a process [s]."""
    fields = Path(f'/proc/{pid}/stat').read_text(encoding='ascii').rpartition(')')[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS


def resident(pid: int) -> float:
    """Resident memory of a process [MB]."""
    pages = int(Path(f'/proc/{pid}/statm').read_text(encoding='ascii').split()[1])
    return pages * os.sysconf('SC_PAGE_SIZE') / 1e6


class Driver:
    """Publishes a rig's messages at a rate, and notes when the answers come."""

    def __init__(self) -> None:
        self.node = Node('driver')
        self.command, self.joints = (self.node.create_publisher(JointState, topic, 200)
                                     for topic in (COMMAND, JOINTS))
        self.write_command = Writer(['u_m'], 'V')
        self.joint_state = JointState(name=['rig'], position=[0.0], effort=[0.0])
        self.models = self.node.create_client(SetParameters, '/hydro_twin/set_parameters')
        self.arrived: dict[int, int] = {}
        self.stamp_of = Reader([SignalMap(JOINTS, 'sensor_msgs/msg/JointState', 'effort[0]')]).read
        self.node.create_subscription(JointState, '/hydro_twin/prediction', self.note,
                                      QoSProfile(depth=5000), raw=True)
        executor = make_executor()
        executor.add_node(self.node)
        self.thread = threading.Thread(target=self.spin, args=[executor], daemon=True)
        self.thread.start()

    def spin(self, executor: Executor) -> None:
        """Take what arrives."""
        with contextlib.suppress(ExternalShutdownException):
            while rclpy.ok():
                executor.spin_once(timeout_sec=0.2)

    def note(self, payload: bytes) -> None:
        """Note when an answer has come."""
        self.arrived.setdefault(self.stamp_of(payload)[0] or 0, time.monotonic_ns())

    def drive(self, pid: int, rate: float, seconds: float,
              swaps: Sequence[Path] = ()) -> dict[str, float]:
        """Drive the other process, and swap models all the while; figures from when it settled."""
        while not (self.command.get_subscription_count() and self.joints.get_subscription_count()
                   and self.node.count_publishers('/hydro_twin/prediction')):
            time.sleep(0.05)
        time.sleep(0.5)
        self.arrived.clear()
        sent: dict[int, int] = {}
        rng = np.random.default_rng(0)
        torque = (10 * rng.normal(size=4096)).tolist()
        step, begin = round(2e6), 1_000_000_000_000_000
        started = time.monotonic()
        count, settled = round((SETTLE + seconds) * rate), round(SETTLE * rate)
        used = wall = begun = 0.0
        swapped = 0
        for k in range(count):
            if (ahead := started + k / rate - time.monotonic()) > 0:
                time.sleep(ahead)
            if k == settled:
                used, wall, begun = cpu(pid), time.monotonic(), resident(pid)
            if swaps and k % round(SETTLE * rate) == 0:
                model = Parameter('model', value=str(swaps[swapped % len(swaps)]))
                self.models.call_async(SetParameters.Request(
                    parameters=[model.to_parameter_msg()]))
                swapped += 1
            stamp = begin + k * step
            self.command.publish(self.write_command.write(stamp, torque[k % 4096] / 100))
            header = self.joint_state.header.stamp
            header.sec, header.nanosec = divmod(stamp, 1_000_000_000)
            self.joint_state.effort[0] = torque[k % 4096]
            sent[stamp] = time.monotonic_ns()
            self.joints.publish(self.joint_state)
        wall, used = time.monotonic() - wall, cpu(pid) - used
        time.sleep(0.5)
        stamps = [begin + k * step for k in range(settled, count)]
        latency = np.array([self.arrived[s] - sent[s] for s in stamps if s in self.arrived]) / 1e3
        p50, p99 = np.percentile(latency, [50, 99]) if len(latency) else (np.nan, np.nan)
        return {'p50_us': round(float(p50), 1), 'p99_us': round(float(p99), 1),
                'cpu_percent': round(100 * used / wall, 2),
                'rate_driven_hz': round((count - settled) / wall, 1),
                'sent': len(stamps), 'answered': len(latency),
                'answers_too_many': len(set(self.arrived) - set(sent)), 'swaps': swapped,
                'resident_mb': round(resident(pid), 1),
                'grown_mb': round(resident(pid) - begun, 2)}


def twin(model: Path, *more: str) -> list[str]:
    """Command line of the node."""
    return ['-m', 'hydro_twin.ros.spin', '--ros-args', '-p', f'model:={model}', *more]


def main() -> None:
    """Measure, and print one JSON object a line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--seconds', type=float, default=10.0)
    parser.add_argument('--rate', type=float, default=500.0)
    parser.add_argument('--only', nargs='*', default=[])
    parser.add_argument('--repeat', type=int, default=2, help='bare and twins in turn')
    parser.add_argument('--rates', type=float, nargs='*', default=[1000.0, 1500.0, 2000.0])
    parser.add_argument('--messages', type=int, default=2_000_000, help='of the memory run')
    parser.add_argument('--bare', action='store_true', help=argparse.SUPPRESS)
    args = parser.parse_args()
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    os.environ.setdefault('ROS_DOMAIN_ID', '101')   # the tests take others
    if args.bare:
        bare()
        return
    rclpy.init()
    driver = Driver()
    with tempfile.TemporaryDirectory() as folder:
        models = make_models(Path(folder))
        linear = models['linear']
        eight = '[' + ','.join(f't{k}={linear}' for k in range(7)) + ']'
        # (name, rate, command line); several turns, so that each meets the machine's moods
        cases = [('bare', args.rate, [__file__, '--bare'])] + [
            (name, args.rate, twin(path)) for name, path in models.items()]
        observer = twin(observed(models['two effects']), '-p', 'mode:=observer')
        cases.append(('two effects, observer', args.rate, observer))
        cases = cases * args.repeat
        cases.append(('eight twins', args.rate, twin(linear, '-p', f'models:={eight}')))
        cases.append(('swapped', args.rate, twin(linear)))
        for rate in args.rates:
            cases += [('bare', rate, [__file__, '--bare']), ('linear', rate, twin(linear)),
                      ('two effects, observer', rate, observer)]
        found: dict[tuple[str, float], list[dict[str, float]]] = {}
        for name, rate, command in cases:
            if args.only and name not in args.only:
                continue
            with running(command) as process:
                figures = driver.drive(process.pid, rate, args.seconds,
                                       list(models.values()) if name == 'swapped' else ())
            found.setdefault((name, rate), []).append(figures)
            print(json.dumps({'case': name, 'rate_hz': rate, **figures}), flush=True)
            time.sleep(1.0)
        show_ratios(found)
        if not args.only:
            print(json.dumps({'step against publish': one_step_against_publish(linear)}))
            print(json.dumps({'memory': memory(linear, args.messages)}))
    rclpy.try_shutdown()
    driver.thread.join()


def memory(model: Path, messages: int) -> dict[str, float]:
    """Run all of the twin but ROS over many messages, as fast as it goes."""
    twin_ = load_twin(Choice('', model), 'one_step')
    live = TwinInputs(PLANT, load_signals(PLANT.name, [s.name for s in PLANT.signals]), 0.002, 0.1)
    outlet = Outlet(twin_, 1, len, len, len, len, len)
    diagnosis = Diagnosis(live, [twin_])
    command, state = Writer(['u_m'], 'V'), JointState(name=['rig'], position=[0.0], effort=[0.0])
    begun, started = 0.0, time.monotonic()
    for k in range(messages // 2):
        stamp = 10**15 + k * 2_000_000
        state.header.stamp.sec, state.header.stamp.nanosec = divmod(stamp, 1_000_000_000)
        state.effort[0] = float(k % 100)
        for feed, payload in zip(live.feeds, (command.write(stamp, k % 7.0),
                                              serialize_message(state)), strict=True):
            live.take(feed, payload, time.time_ns)
        while live.aligner.advance():
            outlet.step(live.aligner.stamp, live.aligner.inputs, live.aligner.measured)
        if k % 500 == 0:
            twin_.monitor.judge()
            diagnosis.statuses(time.time_ns(), 1.0, {})
        if k == messages // 20:
            begun = resident(os.getpid())
    return {'messages': messages, 'predictions': twin_.predictions,
            'grown_mb_after_a_tenth': round(resident(os.getpid()) - begun, 2),
            'us_per_sample': round(2e6 * (time.monotonic() - started) / messages, 1)}


def one_step_against_publish(model: Path) -> dict[str, float]:
    """Compare a live step of the linear predictor with a publish that someone hears, at 500 Hz."""
    stepper, inputs = load_twin(Choice('', model), 'one_step').predictor.stepper('one_step'), \
        np.zeros(2)
    node, count = Node('publisher'), 2000
    publisher = node.create_publisher(JointState, JOINTS, 200)
    with running([__file__, '--bare']):
        while not publisher.get_subscription_count():
            time.sleep(0.05)
        message = JointState(name=['rig'], position=[0.0], effort=[0.0])
        times = []
        for work in (lambda: stepper.step(inputs, 1.0), lambda: publisher.publish(message)):
            each = []
            for _ in range(count):
                time.sleep(0.002)   # as in life, with caches gone cold
                begin = time.perf_counter_ns()
                work()
                each.append(time.perf_counter_ns() - begin)
            times.append(float(np.median(each)) / 1e3)
    node.destroy_node()
    return {'step_us': round(times[0], 2), 'publish_us': round(times[1], 2),
            'ratio': round(times[0] / times[1], 3)}


def show_ratios(found: dict[tuple[str, float], list[dict[str, float]]]) -> None:
    """Print each case against the bare node at the same rate; medians of the turns."""
    for (name, rate), turns in found.items():
        if name == 'bare' or ('bare', rate) not in found:
            continue
        ratios = {}
        for figure in ('p50_us', 'p99_us', 'cpu_percent'):
            ours = np.median([turn[figure] for turn in turns])
            theirs = np.median([turn[figure] for turn in found['bare', rate]])
            ratios[figure.partition('_')[0]] = round(float(ours / theirs), 3)
        print(json.dumps({'case': name, 'rate_hz': rate, 'against_bare': ratios}), flush=True)


if __name__ == '__main__':
    main()
