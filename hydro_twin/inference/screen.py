"""Screening: what each effect could explain of a residual that re-estimated parameters could not.

A score test with steps of finite size [Rao 1948; here on a grid, since a dead zone or a backlash
has no slope at zero]: add the effect, run, take off what the fitted parameters could do as well,
and correlate with the residual.
"""
from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
import math

import numpy as np
import numpy.typing as npt

from hydro_twin.arrays import FloatArray
from hydro_twin.effects import Effect, EFFECTS, Placed, sites, Span
from hydro_twin.fitting.fit import Fit, project_out
from hydro_twin.fitting.output_error import initial_states, residuals_from
from hydro_twin.fitting.parts import Part, travel_of
from hydro_twin.fitting.port_signals import simulate_port_signals
from hydro_twin.fitting.unknowns import left_alone
from hydro_twin.model import Model
from hydro_twin.parallel import in_processes
from hydro_twin.plants import Plant, Port
from hydro_twin.result import Undetectable

NEAR = 0.9              # share of the largest value, from which it counts as near that
FAR = 0.05              # by how much less a start counts, times the squared logarithm of its gain:
#                         a tenth less where it is four times too weak or too strong
DETECTABLE = 50.0       # ratio of an effect's energy to the noise variance at which it shows


@dataclass(frozen=True)
class ScoredEffect:
    """An effect on a port with a start for its search.

    Attributes:
        share: of the residual's power that it explains at that start, scaled to fit.
        gain: the scale that fits; near 1 the start is about right.
    """

    placed: Placed
    share: float
    gain: float


def spans(candidate: Model, parts: Sequence[Part]) -> dict[Port, Span]:
    """Find the range of each port and signal when the candidate runs over the parts.

    From the first scored sample on: a state that the first samples hardly determine may start
    anywhere.
    """
    plant = candidate.plant
    runs = [seen[candidate.start_up:] for seen in simulate_port_signals(candidate, parts)]
    lows, highs = (np.array([reach(run, axis=0) for run in runs]) for reach in (np.min, np.max))
    low, high = lows.min(axis=0), highs.max(axis=0)
    P = len(plant.ports)
    lasting = np.max([longest_run(near) for run in runs for near in (
        run[:, :P] >= NEAR * high[:P], run[:, :P] <= NEAR * low[:P])], axis=0)
    travel, duration = travel_of(parts), candidate.sample_time * max(map(len, runs))
    found, at = {}, len(plant.ports)
    for port in plant.parameter_ports:
        found[port] = Span(((0.0, 0.0),), {}, travel, candidate.sample_time, 0, duration)
    for row, port in enumerate(plant.ports):
        here = slice(at, at + len(port.signals))
        found[port] = Span(
            tuple(zip(lows[:, row].tolist(), highs[:, row].tolist(), strict=True)),
            {name: (float(least), float(most)) for name, least, most in zip(
                port.signals, low[here], high[here], strict=True)},
            travel, candidate.sample_time, int(lasting[row]), duration)
        at = here.stop
    return found


def longest_run(holds: npt.NDArray[np.bool_]) -> npt.NDArray[np.int64]:
    """Count the most samples in a row at which something holds, of each column of (N, rows)."""
    count = np.cumsum(holds, axis=0)
    since = count - np.maximum.accumulate(np.where(holds, 0, count), axis=0)
    most: npt.NDArray[np.int64] = since.max(axis=0)
    return most


def places(plant: Plant, taken: Sequence[Placed], parameters: bool = False
           ) -> list[tuple[Effect, Port]]:
    """List every effect on every port it may sit on, less those taken.

    Effects on parameters, as a drift, only if they are asked for; and of parameters that act only
    together, on one.
    """
    used = {(placed.effect, placed.port) for placed in taken}
    together = left_alone(plant)
    return [(effect, port) for effect in EFFECTS for port in sites(effect, plant)
            if (effect, port) not in used
            and (parameters or effect.course is None)
            and (effect.course is None or port.name not in together)]


def screen(fit: Fit, parts: Sequence[Part]) -> list[ScoredEffect]:
    """Rank effects by what they explain of the residual of a fit.

    Returns:
        For every effect and port its best starts, at most two, best effect first.
    """
    fit, candidate = fit.main, fit.candidate
    reach = spans(candidate, parts)
    basis = fit.tangent_basis
    residual = project_out(fit.residual, basis)
    power = float(residual @ residual)
    starts = [placed for effect, port in places(candidate.plant, candidate.effects)
              for placed in _starts(effect, port, reach[port])]
    without = _run_baseline(fit, parts)
    scored: dict[tuple[str, str], list[ScoredEffect]] = {}
    for placed, moved in zip(
            starts, in_processes(partial(_response, without, parts, basis), starts), strict=True):
        size = float(moved @ moved)
        along = float(moved @ residual)
        if not math.isfinite(size) or size <= 0.0:
            continue
        right_way = max(along, 0.0)
        one = ScoredEffect(placed, right_way**2 / (size * power), right_way / size)
        scored.setdefault(placed.key, []).append(one)
    best = [sorted(some, key=_rank, reverse=True)[:2] for some in scored.values()]
    return [p for some in sorted(best, key=lambda some: _rank(some[0]), reverse=True)
            for p in some]


def _starts(effect: Effect, port: Port, reach: Span) -> list[Placed]:
    """List the starts of an effect that are within its bounds."""
    return [Placed(effect, port, tuple(values)) for values in effect.starts(reach)
            if all(p.lower <= v <= p.upper
                   for p, v in zip(effect.parameters, values, strict=True))]


@dataclass(frozen=True)
class _Baseline:
    """A model before an effect is added: its initial states, and its residual, (N,)."""

    candidate: Model
    states: FloatArray
    residual: FloatArray


def _run_baseline(fit: Fit, parts: Sequence[Part]) -> _Baseline:
    """Run a fitted model as `_response` runs it with an effect."""
    states = initial_states(fit.candidate, parts).x
    return _Baseline(fit.candidate, states,
                     np.concatenate(residuals_from(fit.candidate, parts, states)))


def _response(without: _Baseline, parts: Sequence[Part], basis: FloatArray, placed: Placed
              ) -> FloatArray:
    """Return how an effect moves the output beyond what re-estimated parameters could do, (N,)."""
    candidate = replace(without.candidate, effects=(*without.candidate.effects, placed))
    left = np.concatenate(residuals_from(candidate, parts, without.states))
    return project_out(without.residual - left, basis)


def _rank(scored: ScoredEffect) -> float:
    """Share explained, reduced where the start is much too weak or too strong to be linear."""
    if scored.gain <= 0.0:
        return 0.0
    return scored.share / (1.0 + FAR * math.log(scored.gain) ** 2)


def undetectable(fit: Fit, parts: Sequence[Part]) -> list[Undetectable]:
    """List the effects that would not have shown at any strength, and limits beyond reach."""
    reach = spans(fit.candidate, parts)
    found = []
    for effect, port, shown in detectability(fit, parts, reach):
        if not shown or effect.beyond_reach:
            found.append(Undetectable(effect.id, port.name, _beyond(effect, port, reach[port])
                                      if shown else effect.excitation))
    return found


def _beyond(effect: Effect, port: Port, span: Span) -> str:
    """Say which values a limit was not beyond, by what it limits."""
    limited = effect.parameters[0].unit
    if limited in span.signal_ranges:
        low, high = span.signal_ranges[limited]
        unit, went = port.signals[limited], f'{limited} went from {low:.3g} to {high:.3g}'
    else:
        unit, went = port.unit, f'{port.name} reached {span.value:.3g}'
    return f'the {went}{"" if unit == "1" else f" {unit}"}; a limit beyond that cannot show'


def detectability(fit: Fit, parts: Sequence[Part], reach: Mapping[Port, Span]
                  ) -> list[tuple[Effect, Port, bool]]:
    """Say of every effect at every port whether it would show at any strength tried.

    It does if what re-estimated parameters could not do of it would stand out of the residual as
    it is.

    Args:
        fit: of a model.
        parts: what was recorded.
        reach: see `spans`.
    """
    fit = fit.main
    basis = fit.tangent_basis
    noise = project_out(fit.residual, basis)
    least = DETECTABLE * float(noise @ noise) / len(noise)
    everywhere = places(fit.candidate.plant, fit.candidate.effects)
    begun = [_starts(effect, port, reach[port]) for effect, port in everywhere]
    showing = in_processes(
        partial(_is_detectable, _run_baseline(fit, parts), parts, basis, least), begun)
    return [(effect, port, shown)
            for (effect, port), shown in zip(everywhere, showing, strict=True)]


def _is_detectable(without: _Baseline, parts: Sequence[Part], basis: FloatArray, least: float,
                   starts: Sequence[Placed]) -> bool:
    """Whether an effect moves the output by `least` at any start; the strongest come last."""
    for placed in reversed(starts):
        moved = _response(without, parts, basis, placed)
        if least <= float(moved @ moved) < math.inf:
            return True
    return False
