"""What a rig may have besides its laws, and how it is drawn: the registry of laws by effect."""
from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
import math
from typing import NamedTuple

import numpy as np

from benchmarks.tracing.signals import delayed, FloatArray, Generator, play, relay, slew

Fields = dict[str, float | str]


class Scales(NamedTuple):
    """Largest values of the linear rig over a recording."""

    u: float
    x: float
    x_rate: float
    p: float
    omega: float
    span: float      # of theta_j [rad]
    torque: float
    duration: float  # of the whole recording [s]


class Command(NamedTuple):
    """What happens to the command [V] before the spool; by default nothing."""

    command_bias: float = 0.0
    command_limit: float = math.inf
    command_dead: float = 0.0
    command_play: float = 0.0
    command_play_spread: float = 0.0   # two more plays, this far to either side
    relay_width: float = 0.0
    relay_height: float = 0.0
    command_slew: float = math.inf     # [V/s]
    delay: float = 0.0                 # [s]
    delay_kind: str = 'pure'

    def on(self, u: FloatArray, step: float) -> FloatArray:
        """Return the command that reaches the spool."""
        u = np.clip(u + self.command_bias, -self.command_limit, self.command_limit)
        u = u - np.clip(u, -self.command_dead, self.command_dead)
        if self.command_play_spread:
            widths = self.command_play * (1 + self.command_play_spread * np.array([-1, 0, 1]))
            u = np.mean([play(u, w) for w in widths], axis=0)
        elif self.command_play:
            u = play(u, self.command_play)
        if self.relay_height:
            u = relay(u, self.relay_width, self.relay_height)
        if self.command_slew < math.inf:
            u = slew(u, self.command_slew * step)
        if self.delay:
            u = delayed(u, self.delay, step, self.delay_kind)
        return u


class Sensor(NamedTuple):
    """What befalls the sensed torque besides noise [N m]."""

    sensor_bias: float = 0.0
    line: float = 0.0
    line_hz: float = 0.0
    disturbance: float = 0.0           # rms of an AR(1) process
    disturbance_memory: float = 0.0
    burst: float = 0.0                 # a short burst of high frequency
    burst_hz: float = 0.0


class Built(NamedTuple):
    """One effect as it was built into a rig."""

    id: str
    law: str
    fields: Fields


Draw = Callable[[Scales, Generator], Fields]
LAWS: dict[str, dict[str, list[tuple[str, Draw]]]] = {
    kind: defaultdict(list) for kind in ('single', 'variant', 'outside')}


def law(kind: str, effect: str) -> Callable[[Draw], Draw]:
    """Register a draw: a law of a library effect, another law for it, or one outside it."""
    def register(draw: Draw) -> Draw:
        LAWS[kind][effect].append((draw.__name__, draw))
        return draw
    return register


def share(rng: Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def sign(rng: Generator) -> float:
    return float(rng.choice((-1.0, 1.0)))
