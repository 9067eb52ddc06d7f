"""A law without a name: a free curve at the port, over the signal, where it improves most."""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math

import numpy as np

from hydro_twin.effects import Placed
from hydro_twin.effects.curve import curve, KNOTS, values
from hydro_twin.fitting.fit import Fit
from hydro_twin.fitting.output_error import free_run_error
from hydro_twin.fitting.parts import Part
from hydro_twin.fitting.port_signals import predicted_by_ports
from hydro_twin.inference.criterion import CLEAR_DELTA_BIC, delta_bic, gain_p_value
from hydro_twin.inference.effect_signals import effect_signals
from hydro_twin.inference.held_out import held_out_gain, residuals
from hydro_twin.inference.noise import MAX_COLOURED_NOISE_RATIO, noise_floor
from hydro_twin.inference.screen import spans
from hydro_twin.inference.search import search_all
from hydro_twin.inference.structure import is_significant_dependence
from hydro_twin.model import Model
from hydro_twin.plants import Port
from hydro_twin.result import Dependence, Improvement

MOST, KEPT = 8, 3       # curves that are fitted, and of these fitted to convergence
ALIKE = 1e-4            # of the shares of two that are the same but for a factor
SHORT, LONG = 8, 25     # evaluations of a search: to compare, to converge
P_TRY_CURVES = 0.01     # p-value below which the port signals predict the residual
LEVEL = 1e-3            # significance of the best curve, corrected for all that were tried
STRENGTHS = (1.0, 0.3, 0.1)     # factors of the curve from the linear laws, to start from
DRAWN = 0.9             # share of what a curve explains, from which a law of the same is enough
LARGEST = 3.0           # values of a curve, over the largest that passes its port without it
CONSTANT = 0.9          # share of a curve's power that is its mean, from which it is a bias


@dataclass(frozen=True)
class FittedCurve:
    """A curve that improves a model, fitted in full with all of its parameters.

    Attributes:
        fit: its last effect is the curve.
        gain: its improvement on held-out data.
        p_value: of the likelihood ratio, corrected for all that was tried.
        others: curves at other ports or signals with their delta BIC, nearest first.
    """

    fit: Fit
    gain: Improvement
    p_value: float
    others: tuple[tuple[Placed, float], ...]

    @property
    def placed(self) -> Placed:
        """The curve."""
        return self.fit.candidate.effects[-1]


def find_curve(fit: Fit, parts: Sequence[Part], held_out: Sequence[Part],
               curves: Sequence[Dependence], seed: int, most_error: float = math.inf
               ) -> FittedCurve | None:
    """Fit a curve at each port over each signal where something shows; the best, if it helps.

    Carried by the linear laws, no single curve may show where the missing one has biased the fit.

    Args:
        fit: the model whose residual has structure.
        parts: the data that it was fitted to.
        held_out: the data that it was not.
        curves: what each explains of the residual by the linear laws, the most first.
        seed: of the bootstrap.
        most_error: what leaves more after a short search is not searched on.

    Returns:
        None where no curve improves the free run on held-out data.
    """
    if not curves or (not any(map(is_significant_dependence, curves))
                      and predicted_by_ports(fit, parts)[1] > P_TRY_CURVES):
        return None
    places = distinct(curves)[:MOST]
    carried = spans(fit.candidate, parts)

    def begin(candidate: Model, place: Dependence) -> Model:
        return _begin(candidate, place, parts, LARGEST * carried[place.port].value)

    short = search_all([begin(fit.candidate, place) for place in places], parts, SHORT)
    tried = [one for one in sorted(zip(short, places, strict=True), key=lambda one: one[0].cost)
             if one[0].error <= most_error][:KEPT]
    if not tried:
        return None
    # The missing curve may have biased the parameters: so from the middle of the box, too.
    plant = fit.candidate.plant
    middle = replace(fit.candidate, values={**fit.candidate.values, **plant.middle()})
    begun = [_spread(one.candidate, parts) for one, _ in tried]
    begun += [begin(middle, place) for _, place in tried]
    fits = list(search_all(begun, parts, LONG))
    nearer = [min(both, key=lambda one: one.cost) for both in zip(
        fits[:len(tried)], fits[len(tried):], strict=True)]
    # Again, with knots over what the signal reaches by now.
    fits = list(search_all([_spread(one.candidate, parts) for one in nearer], parts, LONG))
    scores = delta_bic(fits)
    first, *rest = sorted(range(len(fits)), key=lambda k: scores[k])
    p_value = gain_p_value(fit, fits[first], len(curves))
    helps = held_out_gain(fit, fits[first], held_out, seed)
    if p_value > LEVEL or not helps.low > 0.0:
        return None
    others = [(fits[k].candidate.effects[-1], scores[k] - scores[first]) for k in rest]
    return FittedCurve(fits[first], helps, p_value,
                       tuple(sorted(others, key=lambda other: other[1])))


def is_better(found: FittedCurve, base: Fit, named: Fit, curves: Sequence[Dependence],
              held_out: Sequence[Part]) -> bool:
    """Whether one curve is clearly better than all effects that were named instead of it.

    On the fitted data, and on the held-out data, see `outweighs`. Not where one of these is a law
    of the same signal at the same port (or where a curve would do as well) that explains most of
    what the curve does, which only describes it more finely; nor where it is a bias, and the curve
    little else.

    Args:
        found: a curve on the model before.
        base: the model before.
        named: the model with effects.
        curves: what each explains of the residual of the model before.
        held_out: the data that were not fitted.
    """
    here = [found.placed, *(other for other, distance in found.others
                            if distance < CLEAR_DELTA_BIC)]
    biased = any(is_bias(placed) for placed in named.candidate.effects)
    drawn = (any(has_equivalent_law((one.port, one.effect.reads[0]), named, curves)
                 for one in here)
             and explains_most(base, named, found.fit))
    if drawn or (biased and is_mostly_constant(found.fit, held_out)):
        return False
    with_curve, with_names = delta_bic([found.fit, named])
    return with_curve < with_names - CLEAR_DELTA_BIC and outweighs(found.fit, named, held_out)


def outweighs(with_curve: Fit, named: Fit, held_out: Sequence[Part]) -> bool:
    """Whether a curve reduces the error of named effects by more than its own excess over noise.

    A curve with its many parameters fits any rig better than a law does. If it reaches the noise
    level and the law does not, the law is wrong. If the curve misfits, too, both models are only
    approximate, and a difference smaller than their misfit is no evidence against a named effect.

    Args:
        with_curve: a model with a free curve.
        named: one with named effects in its place.
        held_out: the data that were not fitted.
    """
    free, law = (residuals(fit, held_out) for fit in (with_curve, named))
    powers = [float(np.mean(np.concatenate(one)**2)) for one in (free, law)]
    return powers[1] - powers[0] > powers[0] - (MAX_COLOURED_NOISE_RATIO * noise_floor(free))**2


def explains_most(base: Fit, named: Fit, with_curve: Fit) -> bool:
    """Whether a law explains most of what a curve in its place does."""
    explained = base.error**2 - named.error**2
    return explained > DRAWN * (base.error**2 - with_curve.error**2)


def has_equivalent_law(place: tuple[Port, str], named: Fit, curves: Sequence[Dependence]) -> bool:
    """Whether an effect that was named is a law of that signal at that port, or as good as that.

    As a gain of the speed over the position is where the integral of the speed leads on.

    Args:
        place: port and signal of a curve.
        named: the model with effects.
        curves: what each curve explains of the residual of the model before.
    """
    shares = {(curve.port, curve.signal): curve.share for curve in curves}
    here = shares[place]
    for placed in named.candidate.effects:
        if (placed.effect.id, place[0].kind) == ('gain', 'linkage'):
            return True
        reads = placed.effect.reads or ('value',)
        there = shares.get((placed.port, reads[0]), 0.0)
        if len(reads) == 1 and abs(there - here) <= ALIKE * abs(here):
            return True
    return False


def is_bias(placed: Placed) -> bool:
    """Whether an effect adds a constant."""
    return placed.effect.id == 'bias'


def is_mostly_constant(fit: Fit, parts: Sequence[Part]) -> bool:
    """Whether the curve of a fit, its last effect, adds a constant and little else.

    But for a straight line, which the parameters of the plant can take off it.
    """
    placed = fit.candidate.effects[-1]
    seen = [effect_signals(fit.candidate, placed, part) for part in parts]
    added = np.concatenate([one.added for one in seen])
    signal = np.concatenate([one.signals[placed.effect.reads[0]] for one in seen])
    mean, moved = added.mean(), signal - signal.mean()
    slope = (moved @ added) / max(float(moved @ moved), 1e-300)
    bent = added - mean - slope * moved
    return bool(mean**2 > CONSTANT * (mean**2 + np.mean(bent**2)))


def distinct(curves: Sequence[Dependence]) -> list[Dependence]:
    """Leave out curves that are the same as another but for a factor, as flow and opening.

    Of the value of a port and a signal the latter is kept, which says more.
    """
    kept: list[Dependence] = []
    for dependence in sorted(curves, key=lambda d: d.signal == 'value'):
        if all(abs(dependence.share - other.share) > ALIKE * abs(other.share) for other in kept):
            kept.append(dependence)
    return sorted(kept, key=lambda d: -d.share)


def _begin(candidate: Model, dependence: Dependence, parts: Sequence[Part], limit: float
           ) -> Model:
    """Add the curve of a dependence, as strong as helps at once; `limit` bounds its values."""
    low, high = dependence.knots[[0, -1]]
    tried = [replace(candidate, effects=(*candidate.effects, curve(
        dependence.port, dependence.signal, float(low), float(high),
        np.clip(strength * dependence.curve, -limit, limit), limit))) for strength in STRENGTHS]
    return min(tried, key=lambda c: free_run_error(c, parts))


def _spread(candidate: Model, parts: Sequence[Part]) -> Model:
    """Put the knots of the curve over what its signal reached in the recording."""
    *others, placed = candidate.effects
    low, high = signal_range(candidate, parts)
    if not low < high:
        return candidate
    limit = placed.effect.parameters[-1].upper
    added = np.clip(values(placed, np.linspace(low, high, KNOTS)), -limit, limit)
    again = curve(placed.port, placed.effect.reads[0], low, high, added, limit)
    return replace(candidate, effects=(*others, again))


def signal_range(candidate: Model, parts: Sequence[Part]) -> tuple[float, float]:
    """Say what the signal of the curve, the last effect, reached in the recording.

    The range that both the run with the curve and the run without it, from rest, reach: a curve,
    or the initial state fitted with it, may drive its own signal to where the rig never was. The
    output itself is measured.
    """
    placed = candidate.effects[-1]
    signal, system = placed.effect.reads[0], candidate.system
    row = candidate.plant.signal_row(placed.port, signal)
    if np.array_equal(system.step.H[row], system.step.H[len(candidate.plant.ports) - 1]):
        runs = [[part.measured for part in parts]]
    else:
        bare = candidate.without(len(candidate.effects) - 1)
        scored = slice(candidate.start_up, None)
        runs = [[effect_signals(candidate, placed, part).signals[signal][scored]
                 for part in parts], []]
        for part in parts:
            seen = np.zeros((len(part.inputs), len(system.step.H)))
            at_rest = bare.system.at(part.start).start(part.inputs[0], part.measured[0])
            bare.system.run(part.inputs, at_rest, seen=seen, start=part.start)
            runs[1].append(seen[:, row])
    edges = [np.quantile(np.nan_to_num(np.concatenate(run)), [0.001, 0.999]) for run in runs]
    low, high = np.transpose(edges)
    return float(low.max()), float(high.min())
