"""Whether a recording moves the plant enough for a trace to say anything of it.

Before anything is fitted: by the Fisher information of a model on the recording, and by whether
effects would show there above the noise.
"""
from __future__ import annotations

from collections.abc import Mapping, Sized
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from hydro_twin.arrays import FloatArray
from hydro_twin.errors import DataError
from hydro_twin.fitting.fit import Fit
from hydro_twin.fitting.identifiability import UNKNOWN
from hydro_twin.fitting.parts import movement, parts_of
from hydro_twin.fitting.unknowns import get, put, Unknown
from hydro_twin.inference.excerpt import excerpt
from hydro_twin.inference.noise import noise_floor
from hydro_twin.inference.screen import detectability, spans
from hydro_twin.inference.search import unsearched
from hydro_twin.model import Model
from hydro_twin.recording.series import Recording
from hydro_twin.result import Undetectable

KNOWN = 0.25            # relative error that is enough: a change by half is then beyond two errors
WORSE = 3.0             # times the error that the model states, which is enough as well
SHOWN = 0.5             # share of the parameters, and of the effects, that must show
LOWEST, HIGHEST, POINTS = 2e-4, 0.1, 80     # of the frequencies at which motions are compared, as
#                         shares of the sampling rate (0.1 and 50 Hz at 500 Hz); how many
SAID = 3                # parameters, and effects, that the sentence tells


@dataclass(frozen=True)
class Weak:
    """A parameter that a recording shows too little of.

    Attributes:
        std_error: relative, that the recording would give; None: none at all.
        needed: that would be enough.
        signal, hertz: the sine of an input that would show most of it.
        with_it: relative error with as much of that sine beside the recording.
    """

    name: str
    std_error: float | None
    needed: float
    signal: str
    hertz: float
    with_it: float

    @property
    def says(self) -> str:
        """What is lacking, and the excitation that would show it."""
        remedy = f'excite {self.signal} near {self.hertz:.2g} Hz'
        if self.std_error is None:
            return (f'{self.name} is not determined (standard error at most {self.needed:.0%} is '
                    f'needed): {remedy}')
        return (f'{self.name}: standard error {self.std_error:.0%}, at most {self.needed:.0%} is '
                f'needed: {remedy}')


@dataclass(frozen=True)
class Excitation:
    """What a recording can tell of a model.

    Attributes:
        std_errors: relative, that it would give each parameter, None where it gives none.
        weak: parameters that the model states an error of, in all `asked`, and that the recording
            shows too little of.
        undetectable: effects that would not show, of all `tried`, at a place each.
        still: why nothing can be said at all, or ''.
    """

    std_errors: Mapping[str, float | None]
    weak: tuple[Weak, ...]
    asked: int
    undetectable: tuple[Undetectable, ...]
    tried: int
    still: str = ''

    @property
    def enough(self) -> bool:
        """Whether a trace is worth its time: half of the parameters and of the effects show."""
        return not (self.still or self._few(self.weak, self.asked)
                    or self._few(self.undetectable, self.tried))

    @staticmethod
    def _few(lacking: Sized, of: int) -> bool:
        return len(lacking) > (1.0 - SHOWN) * of

    @property
    def says(self) -> str:
        """All of it in one sentence, with motions that would show what is lacking, if it is."""
        if self.still:
            return self.still
        said = (f'{self.asked - len(self.weak)} of {self.asked} parameters and '
                f'{self.tried - len(self.undetectable)} of {self.tried} effects would show')
        parts = [one.says for one in self.weak[:SAID]] if self._few(self.weak, self.asked) else []
        if self._few(self.undetectable, self.tried):
            parts += [f'{one.id.replace("_", " ")} at the {one.port}: {one.says}'
                      for one in self.undetectable[:SAID]]
        return '; '.join([said, *parts])


def excitation(recording: Recording, model: Model) -> Excitation:
    """Judge a recording by a model, of the recording's sample time."""
    plant, sample_time = model.plant, model.sample_time
    try:
        parts = excerpt(parts_of(recording, plant), plant, sample_time)
    except DataError as error:
        return Excitation({}, (), 0, (), 0, str(error))
    fit = unsearched(model, parts).main
    noise = noise_floor(fit.by_part)
    # As it would be with nothing left but noise: what there is to be traced must not count.
    fit = replace(fit, residual=noise * np.random.default_rng(0).standard_normal(
        len(fit.residual)))
    size = max(movement([part.measured for part in parts]), 10.0 * noise)
    known = fit.identifiability().std_error
    errors = {u.name: known[u.name] for u in fit.unknowns if u.owner == ''}
    effects = detectability(fit, parts, spans(model, parts))
    return Excitation(
        errors, tuple(_weak(model, errors, _motions(fit, noise, size))),
        sum(model.parameters[name].std_error is not None for name in errors),
        tuple(Undetectable(effect.id, port.name, effect.excitation)
              for effect, port, shown in effects if not shown), len(effects))


def _weak(model: Model, errors: Mapping[str, float | None],
          motions: Mapping[str, tuple[str, float, float]]) -> list[Weak]:
    """List the parameters that the model states an error of, and the recording hardly shows."""
    found = []
    for name, error in errors.items():
        stated = model.parameters[name]
        if stated.std_error is None:
            continue
        needed = max(KNOWN, WORSE * stated.std_error / abs(stated.value))
        if error is None or error > needed:
            found.append(Weak(name, error, needed, *motions[name]))
    return sorted(found, key=lambda one: -(one.std_error or np.inf) / one.needed)


def _motions(fit: Fit, noise: float, size: float) -> dict[str, tuple[str, float, float]]:
    """Find for each parameter the sine of one input that would reduce its standard error most.

    The Fisher information is the sum of a prior as wide as the box, of the recording, and of as
    many samples of the sine, whose amplitude would move the output by `size` at the frequency of
    the largest response.

    Args:
        fit: of the model to the recording.
        noise: RMS.
        size: RMS of the output.

    Returns:
        Parameter -> (input, frequency [Hz], relative error with that sine beside the recording).
    """
    candidate, inputs = fit.candidate, fit.candidate.plant.inputs
    own = [k for k, u in enumerate(fit.unknowns) if u.owner == '']
    hertz = np.geomspace(LOWEST, HIGHEST, POINTS) / candidate.sample_time
    slopes = np.stack([_response_slope(candidate, fit.unknowns[k], hertz) for k in own], axis=-1)
    slopes *= size / noise / np.abs(_response(candidate, hertz)).max(axis=0)[:, None]
    there = fit.jacobian[:, own] / noise
    sines = len(there) * np.einsum('fmi,fmj->mfij', slopes, slopes.conj()).real
    errors = np.sqrt(np.linalg.inv(there.T @ there + np.eye(len(own)) / UNKNOWN**2 + sines)
                     .diagonal(axis1=-2, axis2=-1))                  # (m, F, parameters)
    found = {}
    for i, k in enumerate(own):
        m, f = np.unravel_index(errors[:, :, i].argmin(), errors.shape[:2])
        found[fit.unknowns[k].name] = inputs[m].name, float(hertz[f]), float(errors[m, f, i])
    return found


def _response_slope(candidate: Model, unknown: Unknown, hertz: FloatArray
                    ) -> npt.NDArray[np.complex128]:
    """Differentiate the frequency response of the linear laws by a coordinate, (F, m)."""
    there = unknown.coordinate(get(candidate, unknown))
    low, high = (_response(put(candidate, [unknown], [unknown.value(there + step)]), hertz)
                 for step in (-1e-3, 1e-3))
    slope: npt.NDArray[np.complex128] = (high - low) / 2e-3
    return slope


def _response(candidate: Model, hertz: FloatArray) -> npt.NDArray[np.complex128]:
    """Return the frequency response of the linear laws to each input, (F, m)."""
    laws = candidate.plant.laws(candidate.values)
    s = 2j * np.pi * hertz[:, None, None]
    states = np.linalg.solve(s * np.eye(len(laws.A)) - laws.A, laws.B[None])
    return np.asarray((laws.C @ states + laws.D)[:, 0, :], complex)
