"""A toy predictor, and messages for the live twin made by rosbags: independent of its reader."""
from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
import math
from typing import Any

import numpy as np
from rosbags.typesys import get_typestore, Stores

from hydro_twin.live.inputs import TwinInputs
from hydro_twin.model import Model, Record
from hydro_twin.plants import Plant, plant_named
from hydro_twin.recording.signals import SignalMap

STORE = get_typestore(Stores.ROS2_JAZZY)
JOINTS = 'sensor_msgs/msg/JointState'
PLANT = plant_named('load_simulator')
STEP = 2_000_000
START = 1_700_000_000_123_456_789
SIGNALS = {'u_m': SignalMap('/command', JOINTS, 'position[0]'),
           'theta_d': SignalMap('/joint_states', JOINTS, 'position[shaft]'),
           'T_g': SignalMap('/joint_states', JOINTS, 'effort[shaft]')}


def joint_state(stamp: int, names: Sequence[str], position: Sequence[float],
                effort: Sequence[float] = (), frame: str = '') -> bytes:
    types = STORE.types
    seconds, nanoseconds = divmod(stamp, 1_000_000_000)
    message = types[JOINTS](
        types['std_msgs/msg/Header'](
            types['builtin_interfaces/msg/Time'](seconds, nanoseconds), frame),
        list(names), np.array(position, float), np.zeros(0), np.array(effort, float))
    return bytes(STORE.serialize_cdr(message, JOINTS))


def model(reference_rms: float | None = 1.0) -> Model:
    values = {p.name: (p.lower * p.upper)**0.5 for p in PLANT.parameters}
    errors = {} if reference_rms is None else {
        'after': {mode: {'test': reference_rms} for mode in ('one_step', 'free_run')}}
    return Model(PLANT, PLANT.constant_values() | values, PLANT.sample_time,
                 record=Record(errors=errors))


@dataclass
class Echo:
    """Predicts `gain` times the last measured output: 1 persists, above 1 diverges."""

    model: Model
    gain: float = 1.0
    plant: Plant = PLANT
    sample_time: float = 0.002
    started: int = 0

    def stepper(self, mode: str) -> EchoStepper:
        self.started += 1
        return EchoStepper(self.gain, free=mode == 'free_run')


@dataclass
class EchoStepper:
    gain: float
    free: bool
    last: float = math.nan

    def step(self, inputs: Any, measured: float, stamp: int | None = None,
             sensors: Any = None) -> float:
        prediction = self.gain * self.last
        if not self.free or math.isnan(self.last):
            self.last = measured
        else:
            self.last = prediction
        return prediction


@dataclass
class Sink:
    """Takes all the samples that a live twin makes."""

    live: TwinInputs = field(default_factory=lambda: TwinInputs(PLANT, SIGNALS, 0.002, 0.1))
    samples: list[tuple[int, float, float, float, bool]] = field(default_factory=list)

    def feed(self, topic: int, payload: bytes, now: int = 0) -> None:
        self.live.take(self.live.feeds[topic], payload, lambda: now)
        self.drain()

    def tick(self, now: int) -> None:
        self.live.tick(now)
        self.drain()

    def drain(self) -> None:
        aligner = self.live.aligner
        while aligner.advance():
            self.samples.append((aligner.stamp, *aligner.inputs.tolist(), aligner.measured,
                                 aligner.first))

    def run(self, ks: Iterable[int]) -> None:
        """Feed both topics the samples k: u_m = k, theta_d = 2 k, T_g = 3 k."""
        for k in ks:
            self.feed(0, joint_state(START + k * STEP, ['valve'], [k]))
            self.feed(1, joint_state(START + k * STEP, ['shaft'], [2 * k], [3 * k]))

    @property
    def ks(self) -> list[float]:
        return [(stamp - START) / STEP for stamp, *_ in self.samples]

    @property
    def firsts(self) -> list[float]:
        return [(s[0] - START) / STEP for s in self.samples if s[-1]]
