"""Where a fault enters: the port at which an unknown input best explains the innovation.

Each port in turn is given an unknown input: a random walk, plus a law of the signals there (a
curve, a hysteresis or a lag) with unknown, normally distributed coefficients. The innovation of
the observer with the walk is linear in these coefficients, as in the generalised likelihood ratio
test [Willsky and Jones 1976]. Here they are integrated out, so that the likelihood is maximised
only over the intensities of walk and law.
"""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math

import numpy as np

from hydro_twin.arrays import FloatArray
from hydro_twin.errors import ModelError
from hydro_twin.live.location import Location
from hydro_twin.live.signatures import signatures
from hydro_twin.live.unknown_input import observe, reach, Suspect
from hydro_twin.model import Model
from hydro_twin.predictors.observer import Observer

DOUBT = 0.01            # a port is named beside the best where its odds against that are above
# Where the search for the intensity of the walk begins, in units of the input over the root of a
# second: the unit moves the output by the noise. The first is none, the last a jump every sample.
WALKS = (0.0, 1.0, 7.0)
STEPS = (1.0, 0.5, 0.5)     # of that search, in logarithms: to a quarter
STEP_WALKS = 4          # most walks tried in a step: none, weaker, the same and stronger
LEAST = 0.05            # least walk that a search may come to, which moves nothing in a stretch
# Spread of the coefficients, in shares of that at which the strongest moves the innovation by its
# standard deviation: from too weak to show to a thousand times the noise.
SPREADS = np.exp(np.arange(-3.0, 8.0))
OFFSET_SPREADS = SPREADS[::2]   # of the constant: a coarser grid is enough
FINALISTS = 6           # ports that are searched: those with the same response and some beside


@dataclass(frozen=True)
class _Explanation:
    """A law with its intensities: how likely, and what it adds, in units of the input, (N,)."""

    suspect: Suspect
    law: str
    walk: float
    gain: float
    added: FloatArray


def locate(model: Model, inputs: FloatArray, measured: FloatArray, first: int, last: int
           ) -> Location:
    """Find the port at which an unknown input best explains what was measured.

    Args:
        model: with its noise.
        inputs: of N successive samples, (N, m).
        measured: the output, nan where there is none, (N,).
        first: sample from which on the fault may set in.
        last: sample until which it has; both 0 if it is older than the samples.

    Raises:
        ModelError: the model has no noise, so no observer.
    """
    if model.noise is None:
        raise ModelError('a model without its noise has no observer')
    system = model.system
    start = system.start(inputs[0], float(measured[0]) if math.isfinite(measured[0]) else 0.0)
    observer = Observer(system, model.noise)
    plain = observe(observer, start, inputs, measured,
                    system.step.H[:system.step.sensors])
    onset = change(plain.innovation, first, last)
    counted = max(onset, model.start_up)
    scale = math.sqrt(float(plain.variance[counted:].mean()))
    best, tried = [], 0
    for index in range(len(model.plant.ports)):
        probe = max(1e-3 * float(np.abs(plain.passing[:, index]).max()), 1e-12)
        far = reach(model, index, inputs[onset:], start, probe)
        if 0.0 < far < math.inf:
            suspect = Suspect(model, index, scale / far, inputs, measured, onset, start,
                              observer.filter.process)
            explanations = [one for walk in WALKS for one in _explanations(suspect, walk)]
            tried += len(explanations)
            best.append(max(explanations, key=_gain))
    best.sort(key=_gain, reverse=True)
    searched = [_search(one) for one in best[:FINALISTS]]
    tried += STEP_WALKS * len(STEPS) * len(searched)
    return _verdict(model, searched + best[FINALISTS:], plain.log_likelihood(counted), tried)


def _gain(explanation: _Explanation) -> float:
    return explanation.gain


def _search(best: _Explanation) -> _Explanation:
    """Find the intensity of the walk, with what passes at the port under the law found before."""
    for step in STEPS:
        walks = {0.0, *(max(best.walk * math.exp(way * step), LEAST) for way in (-1.0, 0.0, 1.0))}
        best = max([best, *(one for walk in walks for one in
                            _explanations(best.suspect, walk, best))], key=_gain)
    return best


def _explanations(suspect: Suspect, walk: float, before: _Explanation | None = None
                  ) -> Sequence[_Explanation]:
    """Weigh the laws at a port beside a walk.

    Args:
        suspect: the port.
        walk: its intensity.
        before: only the law of this, which says what passes at the port; all if not given.
    """
    onset, plain = suspect.onset, suspect.run(walk, passing=True)
    begin = max(onset, suspect.model.start_up)
    passing = (suspect.run(walk, before.added, True) if before else plain).passing[onset:]
    ports, index = suspect.model.plant.ports, suspect.index
    at = len(ports) + sum(len(port.signals) for port in ports[:index])
    laws = signatures(ports[index], passing[:, index],
                      passing[:, at:at + len(ports[index].signals)])

    found = []
    for law in (before.law,) if before else laws:
        rows = laws[law]()
        responses = suspect.responses(plain, np.vstack([np.ones(rows.shape[1]), rows]))
        gain, coefficients = integrated(responses[:, begin - onset:], plain.innovation[begin:])
        found.append(_Explanation(suspect, law, walk, plain.log_likelihood(begin) + gain,
                                  coefficients[0] + coefficients[1:] @ rows))
    return found


def change(innovation: FloatArray, first: int, last: int) -> int:
    """Find the sample from which an innovation is larger, by maximum likelihood [Page 1955].

    Args:
        innovation: over its standard deviation, nan where there is none, (N,).
        first: sample from which on to look.
        last: sample until which to look.
    """
    squares = np.nan_to_num(innovation, nan=1.0) ** 2
    larger = max(float(squares[last:].mean()), 1.0)
    gain = 0.5 * ((1.0 - 1.0 / larger) * squares - math.log(larger))
    return first + int(np.argmax(np.cumsum(gain[first:last + 1][::-1])[::-1]))


def integrated(responses: FloatArray, innovation: FloatArray) -> tuple[float, FloatArray]:
    """Integrate the coefficients of a law out of the likelihood of a white innovation.

    Args:
        responses: of the innovation to a constant, then to each signature, (J, N).
        innovation: over its standard deviation, nan where there is none, (N,).

    Returns:
        The logarithm of the likelihood over that without the law, maximised by the spread of the
        constant and that of the others, and the mean of the coefficients then, (J,).
    """
    known = np.isfinite(innovation)
    S, e = responses[:, known], innovation[known]
    G, b = S @ S.T, S @ e
    size = np.sqrt(np.diag(G))
    tops = 1.0 / np.maximum([size[0], size[1:].max()], 1e-300)

    def weigh(constant: float, others: float) -> tuple[float, FloatArray]:
        d = np.r_[constant, np.full(len(b) - 1, others)]
        L = np.linalg.cholesky(np.eye(len(b)) + d[:, None] * G * d)
        z = np.linalg.solve(L, d * b)
        return (float(0.5 * z @ z - np.log(np.diag(L)).sum()),
                d * np.linalg.solve(L.T, z))
    return max((weigh(tops[0] * s, tops[1] * t) for s in OFFSET_SPREADS for t in SPREADS),
               key=lambda found: found[0])


def _verdict(model: Model, found: Sequence[_Explanation], plain: float, tried: int) -> Location:
    """Name the most likely ports, if the evidence is significant.

    Under the model as it is, the likelihood ratio of each explanation has mean 1. So the
    probability that any of K ratios exceeds K / `DOUBT` is at most `DOUBT`.

    Args:
        model: that the ports are of.
        found: the best explanation at each port.
        plain: log-likelihood of the model as it is.
        tried: laws with a walk of which these are the best, each at every pair of spreads.
    """
    names: dict[str, _Explanation] = {}
    for one in sorted(found, key=_gain, reverse=True):
        names.setdefault(model.plant.ports[one.suspect.index].name, one)
    if not names:
        return Location()
    best = next(iter(names.values()))
    ratios = tried * len(OFFSET_SPREADS) * len(SPREADS)
    if best.gain - plain < math.log(ratios / DOUBT):
        return Location(gain=best.gain - plain)
    behind = {name: best.gain - one.gain for name, one in names.items()}
    named = tuple(name for name, less in behind.items() if less < -math.log(DOUBT))
    return Location(named, model.plant.ports[best.suspect.index].meaning, best.gain - plain,
                    tuple(behind.items())[1:])
