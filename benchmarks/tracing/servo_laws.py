"""A turbine valve servo with anything built in, integrated finely: the truth of a benchmark.

Written from [L18] and apart from hydro_twin, so that a mistake there is not repeated here: the
midpoint rule at 50 us, against whatever the product's own step is.
"""
from __future__ import annotations

from collections.abc import Callable
import math
from typing import NamedTuple

from numba import njit
import numpy as np

from benchmarks.tracing.draws import share, sign
from benchmarks.tracing.signals import Generator

INF = math.inf


class Servo(NamedTuple):
    """The loop of [L18] and what else it has; the defaults switch it off."""

    T_y: float
    T_c: float
    tau: float
    k_1: float
    # the loop's error
    dead: float = 0.0               # half width
    error_limit: float = INF
    error_tanh: float = INF
    error_play: float = 0.0         # half width
    # actuator
    speed_up: float = INF           # limits of a' [1/s]
    speed_down: float = INF
    asymmetry: float = 0.0
    gain_slope: float = 0.0         # speed (1 + slope y)
    gain_drift: float = 0.0         # speed (1 + drift sin(rate t))
    gain_drift_rate: float = 0.0
    stop: float = INF               # hard stop of the actuator, seen by the loop
    # stem, after the loop or (inside) seen by it
    limit: float = INF
    stem_play: float = 0.0          # half width
    play_inside: float = 0.0        # 1: the loop sees the play
    curved: float = 0.0             # y (1 + curved (1 - y)), seen by nobody


class Around(NamedTuple):
    """What befalls the command before the loop, and the opening after it."""

    command_bias: float = 0.0
    command_limit: float = INF
    command_dead: float = 0.0       # about half opening
    command_play: float = 0.0
    delay: float = 0.0
    sensor_bias: float = 0.0
    line: float = 0.0
    line_hz: float = 0.0


@njit(cache=True)
def _rates(r, c, a, y, u, seen, held, t):
    e = u - seen
    e -= min(max(e, -r.dead), r.dead)
    if r.error_play > 0.0:
        e = held
    e = min(max(e, -r.error_limit), r.error_limit)
    if r.error_tanh < math.inf:
        e = r.error_tanh * math.tanh(e / r.error_tanh)
    dc = (r.k_1 * e - c) / r.T_y
    speed = c / r.T_c * (1.0 + r.asymmetry * math.copysign(1.0, c)) * (1.0 + r.gain_slope * y)
    speed *= 1.0 + r.gain_drift * math.sin(r.gain_drift_rate * t)
    speed = min(max(speed, -r.speed_down), r.speed_up)
    if a >= r.stop and speed > 0.0:
        speed = 0.0
    return dc, speed, (a - y) / r.tau


@njit(cache=True)
def integrate(r, u, start_time, step, keep):
    """Integrate from rest at the first command; return the opening of every keep-th step."""
    n = len(u) // keep
    out = np.empty(n)
    c, a, y = 0.0, u[0], u[0]
    stem, held = y, 0.0
    half = 0.5 * step
    for i in range(n * keep):
        if i % keep == 0:
            shown = min(stem if r.stem_play > 0.0 else y, r.limit)
            out[i // keep] = shown * (1.0 + r.curved * (1.0 - shown))
        seen = stem if r.play_inside > 0.0 else y
        if r.error_play > 0.0:
            e = u[i] - seen
            held = min(max(held, e - r.error_play), e + r.error_play)
        t = start_time + i * step
        k1 = _rates(r, c, a, y, u[i], seen, held, t)
        inside = seen if r.play_inside > 0.0 else y + half * k1[2]
        k2 = _rates(r, c + half * k1[0], a + half * k1[1], y + half * k1[2], u[i], inside, held, t)
        c += step * k2[0]
        a += step * k2[1]
        y += step * k2[2]
        a = min(a, r.stop)
        stem = min(max(stem, y - r.stem_play), y + r.stem_play)
    return out


class Scales(NamedTuple):
    """Largest values of the linear servo over a recording."""

    u: float
    span: float
    error: float
    speed: float
    top: float
    duration: float


Fields = dict[str, float]
Draw = Callable[[Scales, Generator], Fields]
DRAWS: dict[str, list[tuple[str, str, Draw]]] = {
    'none': [('', '', lambda *_: {})],
    'single': [
        ('saturation', 'stem_limit', lambda s, g: {'limit': s.top - s.span * share(g, .02, .4)}),
        ('rate_limit', 'speed', lambda s, g: dict.fromkeys(
            ('speed_up', 'speed_down'), s.speed * g.uniform(0.2, 0.9))),
        ('dead_zone', 'loop_dead', lambda s, g: {'dead': s.error * share(g, 0.005, 0.3)}),
        ('hysteresis', 'command_play', lambda s, g: {'command_play': s.span * share(g, .005, .2)}),
        ('backlash', 'stem_play', lambda s, g: {'stem_play': s.span * share(g, 0.003, 0.1)}),
        ('delay', 'pure', lambda _, g: {'delay': share(g, 0.004, 0.05)}),
        ('asymmetry', 'uneven', lambda _, g: {'asymmetry': sign(g) * share(g, 0.02, 0.5)}),
        ('bias', 'null', lambda s, g: {'command_bias': sign(g) * s.span * share(g, .01, .2)}),
        ('bias', 'sensor', lambda s, g: {'sensor_bias': sign(g) * s.span * share(g, .01, .2)}),
        ('gain', 'speed_gain', lambda _, g: {
            'gain_slope': g.choice((share(g, 0.1, 2.0), -share(g, 0.1, 0.8)))}),
        ('saturation', 'error_limit', lambda s, g: {'error_limit': s.error * g.uniform(.15, .9)}),
        ('saturation', 'command_limit', lambda s, g: {
            'command_limit': s.u - s.span * share(g, 0.02, 0.4)}),
    ],
    'variant': [
        ('end_stop', 'hard_stop', lambda s, g: {'stop': s.top - s.span * share(g, .03, .4)}),
        ('rate_limit', 'uneven_speed', lambda s, g: {
            'speed_up': s.speed * g.uniform(0.2, 0.8), 'speed_down': s.speed * g.uniform(.2, .8)}),
        ('backlash', 'play_in_loop', lambda s, g: {
            'stem_play': s.span * share(g, 0.003, 0.05), 'play_inside': 1.0}),
        ('hysteresis', 'loop_play', lambda s, g: {'error_play': s.error * share(g, 0.01, 0.2)}),
        ('dead_zone', 'command_dead', lambda s, g: {'command_dead': s.span * share(g, .02, .2)}),
    ],
    'outside': [
        ('soft_error', 'tanh', lambda s, g: {'error_tanh': s.error * share(g, 0.2, 2.0)}),
        ('curved_stem', 'parabola', lambda _, g: {'curved': sign(g) * share(g, 0.03, 0.4)}),
        ('line', 'mains', lambda s, g: {'line': s.span * share(g, .005, .05), 'line_hz': 50.2}),
        ('gain_drift', 'sine', lambda s, g: {
            'gain_drift': share(g, 0.05, 0.4),
            'gain_drift_rate': 2 * np.pi * g.uniform(0.3, 2.0) / s.duration}),
    ],
}
