"""Machines with more physics than the plants have, integrated finely: the truth of a benchmark.

A cylinder with pressures, a spool of second order, dry friction and ends; an axis with dry
friction, a lag in its drive and a flexible end. Written apart from hydro_twin, from [Jelali and
Kroll 2003] and [Armstrong-Helouvry et al. 1994].
"""
from __future__ import annotations

import math
from typing import NamedTuple

from numba import njit
import numpy as np

from benchmarks.tracing.signals import FloatArray

STEP = 5e-5             # [s]
STIFF = 2e8             # of an end of the stroke [N/m]
CREEP = 2e-3            # speed below which friction is viscous [m/s]


class Cylinder(NamedTuple):
    """A servo valve and a cylinder that moves a mass; SI units, the command in shares of 1."""

    supply: float               # pressure
    area: float                 # of the piston
    ratio: float                # area of the rod's side over it
    stroke: float
    flow: float                 # coefficient, m^3/s per sqrt(Pa) at full opening
    stiffness: float            # bulk modulus of the oil
    dead_volume: float
    leakage: float              # m^3/s per Pa between the chambers
    spool: float                # natural frequency [rad/s]
    damping: float              # of the spool, relative
    mass: float
    viscous: float              # N s/m
    coulomb: float              # N
    load: float                 # N, against extending
    overlap_up: float = 0.0     # of the valve
    overlap_down: float = 0.0
    most: float = math.inf      # opening at which it saturates


class Axis(NamedTuple):
    """A drive that moves a mass on a guide; SI units."""

    mass: float
    viscous: float
    coulomb: float
    breakaway: float            # friction at rest, over that in motion
    fades: float                # speed over which the excess does
    bias: float
    lag: float                  # of the drive's current [s]
    end_mass: float             # carried elastically
    end_stiffness: float
    end_damping: float


@njit(cache=True)
def move_cylinder(c, begin, command, gain, every):  # type: ignore[no-untyped-def]
    """Return position and command at every so many steps, from rest at `begin`.

    gain 0: the command is given. Else it is a reference, and the command the gain times what the
    position at the last sample lacks of it, at most 1.
    """
    n = len(command)
    x, v, opening, rate = begin, 0.0, 0.0, 0.0
    p_2 = 0.5 * c.supply
    p_1 = (p_2 * c.area * c.ratio + c.load) / c.area
    asked = 0.0
    places = np.empty(n // every)
    given = np.empty(n // every)
    for k in range(n // every * every):
        if k % every == 0:
            asked = command[k]
            if gain > 0.0:
                asked = min(max(gain * (command[k] - x), -1.0), 1.0)
            places[k // every] = x
            given[k // every] = asked
        elif gain == 0.0:
            asked = command[k]
        rate += STEP * c.spool * (c.spool * (asked - opening) - 2.0 * c.damping * rate)
        opening += STEP * rate
        through = min(max(opening, -c.most), c.most)
        if through > 0.0:
            through = max(through - c.overlap_up, 0.0)
        else:
            through = min(through + c.overlap_down, 0.0)
        if through >= 0.0:
            drop_1, drop_2 = c.supply - p_1, p_2
        else:
            drop_1, drop_2 = p_1, c.supply - p_2
        q_1 = c.flow * through * math.copysign(math.sqrt(abs(drop_1)), drop_1)
        q_2 = c.flow * through * math.copysign(math.sqrt(abs(drop_2)), drop_2)
        lost = c.leakage * (p_1 - p_2)
        a_2 = c.area * c.ratio
        p_1 += STEP * c.stiffness / (c.dead_volume + c.area * x) * (q_1 - lost - c.area * v)
        p_2 += STEP * c.stiffness / (c.dead_volume + a_2 * (c.stroke - x)) * (
            lost + a_2 * v - q_2)
        p_1, p_2 = max(p_1, 0.0), max(p_2, 0.0)
        force = p_1 * c.area - p_2 * a_2 - c.load - c.viscous * v
        if x < 0.0:
            force -= STIFF * x + math.sqrt(STIFF * c.mass) * v
        elif x > c.stroke:
            force -= STIFF * (x - c.stroke) + math.sqrt(STIFF * c.mass) * v
        force -= c.coulomb * min(max(v / CREEP, -1.0), 1.0)
        v += STEP * force / c.mass
        x += STEP * v
    return places, given


@njit(cache=True)
def move_axis(a, reference, stiffness, damping, most, every):  # type: ignore[no-untyped-def]
    """Return position and force asked for at every so many steps, in a loop of position and speed.

    Sticking is solved for: at rest, friction takes up what is less than breakaway.
    """
    n = len(reference)
    x = reference[0]
    v, end, end_v, drive, asked, last = 0.0, 0.0, 0.0, 0.0, 0.0, reference[0]
    places = np.empty(n // every)
    forces = np.empty(n // every)
    for k in range(n // every * every):
        if k % every == 0:
            h = every * STEP
            asked = stiffness * (reference[k] - x) - damping * (x - last) / h
            asked = min(max(asked, -most), most)
            last = x
            places[k // every] = x
            forces[k // every] = asked
        drive += STEP * (asked - drive) / a.lag
        inner = a.end_stiffness * end + a.end_damping * end_v
        force = drive + a.bias - a.viscous * v + inner
        friction = a.coulomb * (1.0 + (a.breakaway - 1.0) * math.exp(-(v / a.fades) ** 2))
        free = v + STEP * force / a.mass
        impulse = STEP * friction / a.mass
        was = v
        v = free - min(max(free, -impulse), impulse)
        end_v += STEP * (-inner / a.end_mass) - (v - was)
        end += STEP * end_v
        x += STEP * v
    return places, forces


def steady_speeds(c: Cylinder) -> tuple[float, float]:
    """Return the speeds at full opening out and in, no friction, no leakage [m/s]."""
    a_1, a_2 = c.area, c.area * c.ratio
    whole = a_1**3 + a_2**3
    out = math.sqrt(max(c.supply * a_1 - c.load, 0.0) / whole)
    back = math.sqrt(max(c.supply * a_2 + c.load, 0.0) / whole)
    return c.flow * out, c.flow * back


def on_fine_steps(times: FloatArray, values: FloatArray, seconds: float, smooth: bool
                  ) -> FloatArray:
    """Hold values from each time on, or join them by lines, over steps of `STEP`."""
    at = STEP * np.arange(round(seconds / STEP))
    if smooth:
        return np.interp(at, times, values)
    return values[np.maximum(np.searchsorted(times, at, side='right') - 1, 0)]
