"""Decomposition of a free curve into named static laws.

A dead zone followed by a saturation is one curve, and no single law. So static laws of the library
are fitted to the curve, alone and composed along the path of its signal. The compositions that fit
it best are then fitted to the recording in its place.
"""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product
from operator import itemgetter

import numpy as np
from scipy.optimize import least_squares

from hydro_twin.arrays import FloatArray
from hydro_twin.effects import Effect, Placed, Span
from hydro_twin.effects.curve import values
from hydro_twin.effects.dispatch import code, transmit
from hydro_twin.fitting.parts import Part
from hydro_twin.fitting.port_signals import simulate_port_signals
from hydro_twin.fitting.unknowns import effect_unknowns
from hydro_twin.inference.effect_signals import effect_signals
from hydro_twin.inference.screen import places, spans
from hydro_twin.model import Model
from hydro_twin.plants import Port

SAMPLES = 100           # values of the signal at which laws are compared with a curve; half of
#                         them evenly spaced, half at quantiles
MIN_COSINE = 0.9        # cosine to the signal of the curve, from which a port is on its path
MAX_LAWS = 3            # in a composition
FORMS = 3               # forms of a law, the best by themselves, that compositions start from
STEPS = 30              # of a fit to the curve, which costs next to nothing
FAR = 5.0               # most that a coordinate moves in it: a factor of 150, or six times a size
MAX_LEFT = 0.5          # share of the power of a curve that a composition may leave
CORNER = 0.01           # share that a curve of few knots misses of laws with corners
MAX_FITTED = 6          # decompositions that are fitted to the recording


@dataclass(frozen=True)
class Site:
    """A static law on the path of a signal.

    Attributes:
        gain: what reaches the port over the signal.
        reach: of the port in the recording.
    """

    effect: Effect
    port: Port
    gain: float
    reach: Span


@dataclass(frozen=True)
class Characteristic:
    """What a curve makes of its signal.

    Attributes:
        signal: values of it, (N,).
        passed: these with what the curve adds, in the unit of the signal, (N,).
    """

    signal: FloatArray
    passed: FloatArray

    @property
    def power(self) -> float:
        """Sum of squares of what the curve bends: what no gain of the plant explains."""
        residual = _residual(self, (), ())
        return float(residual @ residual)


@dataclass(frozen=True)
class Composition:
    """Laws one behind another, and what they leave of a curve, as a sum of squares."""

    left: float
    laws: tuple[Placed, ...]


def is_static(effect: Effect) -> bool:
    """Whether the law of an effect is a function of what reaches its port, and of nothing else."""
    return (effect.law is not None and effect.memory == 0 and not effect.implicit
            and effect.reads in ((), ('value',)))


def decompositions(candidate: Model, parts: Sequence[Part]) -> list[Model]:
    """Put compositions of static laws in the place of a curve, those that fit it best first.

    Args:
        candidate: a model whose last effect is the curve.
        parts: what it was fitted to.

    Returns:
        Up to `MAX_FITTED` models. None where the curve is over something else than what passes at
        its port, or where no composition fits it.
    """
    last = len(candidate.effects) - 1
    target, sites = _along(candidate, last, parts)
    forms = [_forms(target, site) for site in sites]
    tried = [_composed(target, some) for count in range(1, MAX_LAWS + 1)
             for some in combinations(forms, count)]
    power = target.power
    # One law more must leave half as much.
    ranked = sorted((one for one in tried if one.left < MAX_LEFT * power),
                    key=lambda one: (one.left + CORNER * power) * 2.0 ** len(one.laws))
    bare = candidate.without(last)
    return [replace(bare, effects=(*bare.effects, *one.laws)) for one in ranked[:MAX_FITTED]]


def equivalents(candidate: Model, index: int, parts: Sequence[Part]) -> list[Model]:
    """Put other laws in the place of a static one, those with the same curve.

    As a limit of a speed and a limit of the opening that it follows: what was found as one of them
    may as well be the other.

    Args:
        candidate: a model.
        index: of the law among its effects.
        parts: what it was fitted to.
    """
    placed = candidate.effects[index]
    if not is_static(placed.effect):
        return []
    target, sites = _along(candidate, index, parts)
    tried = [min((_composed(target, [[form]]) for form in _forms(target, site)),
                 key=lambda one: one.left)
             for site in sites if site.effect is not placed.effect]
    before, after = candidate.effects[:index], candidate.effects[index + 1:]
    return [replace(candidate, effects=(*before, *one.laws, *after)) for one in tried
            if one.left < CORNER * target.power]


def _along(candidate: Model, index: int, parts: Sequence[Part]
           ) -> tuple[Characteristic, list[Site]]:
    """Find what a curve or static law passes, and the static laws on the path of its signal.

    A port is on the path where what reaches it is proportional to the signal, or to what is made
    of it. Of the ports that a law may sit on, it is at the one where that holds best.
    """
    placed = candidate.effects[index]
    plant, start_up = candidate.plant, candidate.start_up
    at_port = [effect_signals(candidate, placed, part) for part in parts]
    reaching = np.concatenate([
        seen[start_up:] for seen in simulate_port_signals(candidate, parts)])
    read = placed.effect.reads[0] if placed.effect.reads else 'value'
    signal, own = (np.concatenate([np.nan_to_num(one.signals[name][start_up:]) for one in at_port])
                   for name in (read, 'value'))
    passed = own + np.concatenate([one.added[start_up:] for one in at_port])
    reaching[:, plant.ports.index(placed.port)] = own
    if not _alike(signal, own) > MIN_COSINE:
        return Characteristic(signal, signal), []
    reach = spans(candidate.without(index), parts)
    best: dict[str, tuple[float, Site]] = {}
    for effect, port in places(plant, candidate.effects):
        if not is_static(effect):
            continue
        value = reaching[:, plant.ports.index(port)]
        alike, whole = max(((_alike(one, value), one) for one in (signal, passed)),
                           key=itemgetter(0))
        if alike > max(MIN_COSINE, best[effect.id][0] if effect.id in best else 0.0):
            best[effect.id] = alike, Site(effect, port, _gain(whole, value), reach[port])
    sites = sorted((site for _, site in best.values()),
                   key=lambda site: plant.ports.index(site.port))
    share = np.linspace(0.0, 1.0, SAMPLES // 2)
    picked = np.sort(np.concatenate([np.quantile(signal, share),
                                     signal.min() + share * np.ptp(signal)]))
    gain = _gain(signal, own)
    return Characteristic(picked, _passed(placed, gain, picked) if placed.effect.explains else
                          picked + values(placed, picked) / gain), sites


def _passed(placed: Placed, gain: float, signal: FloatArray) -> FloatArray:
    """Pass a signal, of which `gain` times reaches its port, through a law, (N,)."""
    passed = np.array(signal)
    transmit(passed, gain, code(placed.effect), np.array(placed.values), np.zeros(2))
    return passed


def _alike(signal: FloatArray, value: FloatArray) -> float:
    """Return how well a value is a multiple of a signal: the size of the cosine between them."""
    size = float(np.linalg.norm(signal) * np.linalg.norm(value))
    return abs(float(signal @ value)) / size if size > 0.0 else 0.0


def _gain(signal: FloatArray, value: FloatArray) -> float:
    """Return the factor from a signal to a value by least squares."""
    return float(signal @ value) / float(signal @ signal)


def _residual(target: Characteristic, laws: Sequence[Placed], gains: Sequence[float]
              ) -> FloatArray:
    """Return what laws one behind another leave of a curve, at the best gain of the plant."""
    passed = target.signal
    for placed, factor in zip(laws, gains, strict=True):
        passed = _passed(placed, factor, passed)
    power = float(passed @ passed)
    scale = float(passed @ target.passed) / power if power > 0.0 else 0.0
    residual: FloatArray = target.passed - scale * passed
    return residual


def _forms(target: Characteristic, site: Site) -> list[tuple[Site, Placed]]:
    """List the forms of one law that fit a curve best by themselves, at most `FORMS`."""
    def left(placed: Placed) -> float:
        residual = _residual(target, [placed], [site.gain])
        return float(residual @ residual)

    simple = sorted((Placed(site.effect, site.port, tuple(start))
                     for start in site.effect.starts(site.reach)), key=left)[:FORMS]
    refined = [] if site.effect.refined is None else [
        replace(one, values=tuple(form)) for one in simple
        for form in site.effect.refined(site.reach, one.values)]
    return [(site, placed) for placed in sorted([*simple, *refined], key=left)[:FORMS]]


def _composed(target: Characteristic, forms: Sequence[list[tuple[Site, Placed]]]) -> Composition:
    """Fit laws one behind another to a curve, from the best of their forms."""
    gains = [some[0][0].gain for some in forms]

    def left(laws: Sequence[Placed]) -> float:
        residual = _residual(target, laws, gains)
        return float(residual @ residual)

    begun = min(product(*([placed for _, placed in some] for some in forms)), key=left)
    unknowns = [(k, one) for k, placed in enumerate(begun) for one in effect_unknowns(k, placed)]

    def laws_at(coordinates: FloatArray) -> list[Placed]:
        named = [dict(placed.named) for placed in begun]
        for (k, unknown), coordinate in zip(unknowns, coordinates, strict=True):
            named[k][unknown.name] = unknown.value(float(coordinate))
        return [replace(placed, values=tuple(own.values()))
                for placed, own in zip(begun, named, strict=True)]

    def residual(coordinates: FloatArray) -> FloatArray:
        return _residual(target, laws_at(coordinates), gains)

    start = np.array([one.coordinate(begun[k].named[one.name]) for k, one in unknowns])
    found = least_squares(residual, start, bounds=(start - FAR, start + FAR), max_nfev=STEPS)
    laws = min((list(begun), laws_at(found.x)), key=left)
    return Composition(left(laws), tuple(laws))
