"""From where the fits with one effect more begin: models with each effect at each port."""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from hydro_twin.effects import Placed
from hydro_twin.effects.drift import MIN_FACTOR
from hydro_twin.fitting.equation_error import one_step_values
from hydro_twin.fitting.fit import Fit
from hydro_twin.fitting.horizon import between_ends
from hydro_twin.fitting.output_error import initial_states, residuals_from, size_of
from hydro_twin.fitting.parts import Part
from hydro_twin.inference.screen import places, ScoredEffect, spans
from hydro_twin.inference.structure import drift_test, drifts, is_drift_significant
from hydro_twin.model import Model, place
from hydro_twin.parallel import in_processes

AT_ONCE = 0.05          # time constant of a jump at the start of a search, over the recording: a
#                         search moves the jump by about as much, and most starts are nearer to it
AGAIN = 5               # effects with the best scores that are searched from more than one start


def with_effect(candidate: Model, placed: Placed) -> Model:
    """Add an effect; a delay takes the place of the timing."""
    return replace(candidate, effects=(*candidate.effects, placed),
                   timing={} if placed.effect.shifts else candidate.timing)


def with_other(candidate: Model, index: int, placed: Placed) -> Model:
    """Put another effect in the place of one."""
    effects = list(candidate.effects)
    effects[index] = placed
    return replace(candidate, effects=tuple(effects),
                   timing={} if placed.effect.shifts else candidate.timing)


def linear_starts(candidate: Model, parts: Sequence[Part]) -> list[Model]:
    """List linear models to start from: the middle of the box, and fits by the one-step error.

    The missing effect may bias the fit of the free run so much that no search leads back. Where
    the plant integrates, samples at the ends of its travel would make the gain zero, so there is a
    fit to those between, too.
    """
    plant = candidate.plant
    fitted = [parts, between_ends(parts, candidate.sample_time)] if plant.integrates else [parts]
    by_one_step = [values for some in fitted if some for values in one_step_values(
        plant, some, candidate.values, candidate.sample_time)]
    return [replace(candidate, values={**candidate.values, **values}, timing={})
            for values in (plant.middle(), *by_one_step)]


def drift_starts(base: Fit, parts: Sequence[Part], times: tuple[float, float]
                 ) -> list[Model]:
    """Let each parameter drift or jump as estimated from the residual, if there is a drift.

    The total change is limited to its value: for a parameter that the recording hardly determines,
    the estimate may be arbitrarily large.
    """
    if not is_drift_significant(drift_test(base, parts)):
        return []
    begin, end = times
    first = 1e-9 * min(part.start for part in parts)
    plant, found = base.candidate.plant, drifts(base, parts, end - begin)
    models = []
    for effect, port in places(plant, base.candidate.effects, parameters=True):
        if effect.course is None or port.name not in found:
            continue
        change, jump = found[port.name]
        idle = 0.0 if jump is None else first + jump - begin
        settles = {} if jump is None else {
            'idle': idle, 'time_constant': AT_ONCE * (end - begin)}
        models.append(with_effect(base.candidate, place(effect.id, port.name, {
            'rate': min(max(change, MIN_FACTOR - 1.0), 1.0 - MIN_FACTOR) / (end - begin - idle),
            'begin': begin, 'end': end, **settles}, plant)))
    return models


def with_each(linear: Model, parts: Sequence[Part]) -> list[Model]:
    """Add each effect at each port to a model, from each of its starts."""
    reach = spans(linear, parts)
    return [with_effect(linear, Placed(effect, port, tuple(values)))
            for effect, port in places(linear.plant, linear.effects)
            for values in effect.starts(reach[port])]


def best_start_of_each(models: Sequence[Model], parts: Sequence[Part]) -> list[Model]:
    """Add each effect at each port to the model, and from the start, of the lowest error."""
    best: dict[tuple[str, str], tuple[float, Model]] = {}
    for model in models:
        tried = with_each(model, parts)
        states = initial_states(model, parts).x
        left = in_processes(partial(residuals_from, parts=parts, states=states), tried)
        for candidate, misses in zip(tried, map(size_of, left), strict=True):
            key = candidate.effects[-1].key
            if key not in best or misses < best[key][0]:
                best[key] = misses, candidate
    return [candidate for _, candidate in best.values()]


def relocated(candidate: Model, parts: Sequence[Part]) -> list[Model]:
    """Move the last effect to each other port where it can sit, scaled to the signal there.

    A lag of a command and one of a sensor are two laws of one name and the same parameters.
    """
    *others, last = candidate.effects
    reach = spans(candidate, parts)
    moved = []
    for effect, port in places(candidate.plant, others, last.effect.course is not None):
        same = effect.id == last.effect.id and effect.parameters == last.effect.parameters
        if same and port != last.port:
            ratio = reach[port].value / reach[last.port].value
            values = tuple(v * ratio if p.unit == 'value' else v
                           for p, v in zip(effect.parameters, last.values, strict=True))
            moved.append(replace(candidate, effects=(*others, Placed(effect, port, values))))
    return moved


def shortlist(scored: Sequence[ScoredEffect], most: int) -> list[Placed]:
    """Take the effects of the best scores, each from its best start.

    The first few from the second, too, and from the best made as strong as the residual says: a
    law that is far too strong at its start moves the output so far that no search leads back.
    """
    effects: dict[tuple[str, str], list[ScoredEffect]] = {}
    for one in scored:
        effects.setdefault(one.placed.key, []).append(one)
    chosen = []
    for rank, starts in enumerate(effects.values()):
        best = starts[0]
        if rank < most or best.placed.effect.confounded:
            chosen.append(best.placed)
        if rank < min(most, AGAIN):
            chosen += [start.placed for start in starts[1:2]]
            chosen += [best.placed.scaled(best.gain)] if best.gain > 0.0 else []
    return list(dict.fromkeys(chosen))
