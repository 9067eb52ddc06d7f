"""What drives a simulated plant: smooth functions of time, written like sine:frequency=7."""
from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
import inspect

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import butter, lsim, sosfilt

from hydro_twin.arrays import FloatArray
from hydro_twin.errors import UserError
from hydro_twin.plants.plant import Laws
from hydro_twin.simulation.simulate import Excitation

RISE = 0.1                                  # [s] in which what would start abruptly is let in
KNOTS = 20                                  # of random motion, for a period of its bandwidth
ORDERED = (('lowest', 'highest'), ('shortest', 'longest'))      # settings, as they are ordered
LEAST = 1e-6                                # of the largest value of a shape: less is none


@dataclass(frozen=True)
class Run:
    """What an excitation is drawn for: seconds of it, and the source of chance."""

    duration: float
    rng: np.random.Generator


def sine(_: Run, frequency: float = 1.0) -> Excitation:
    """Make a sinusoid [Hz] that starts at zero."""
    return lambda t: np.sin(2 * np.pi * frequency * t)


def multisine(run: Run, lowest: float = 0.2, highest: float = 10.0, lines: float = 20
              ) -> Excitation:
    """Add sinusoids at frequencies spread evenly on a logarithmic scale [Hz], in random phases."""
    f = np.geomspace(lowest, highest, int(lines))
    phase = run.rng.uniform(0, 2 * np.pi, len(f))
    return _normal(run, lambda t: sum(np.sin(2 * np.pi * f_i * t + phi)
                                      for f_i, phi in zip(f, phase, strict=True)))


def chirp(run: Run, first: float = 0.2, last: float = 15.0) -> Excitation:
    """Make a sinusoid whose frequency rises exponentially over the run [Hz]."""
    if first == last:
        return sine(run, first)
    rate = np.log(last / first) / run.duration
    return lambda t: np.sin(2 * np.pi * first / rate * np.expm1(rate * t))


def steps(run: Run, shortest: float = 0.1, longest: float = 0.5) -> Excitation:
    """Hold random levels for random times [s]; the first is zero."""
    edges = np.cumsum(run.rng.uniform(shortest, longest, int(run.duration / shortest) + 1))
    levels = np.append(0.0, run.rng.uniform(-1, 1, len(edges)))
    return lambda t: levels[np.searchsorted(edges, t, side='right')]


def random(run: Run, bandwidth: float = 2.0) -> Excitation:
    """Pass Gaussian noise through a low-pass of second order [Hz]."""
    rate = KNOTS * bandwidth
    knots = np.arange(int(run.duration * rate) + 4) / rate
    noise = run.rng.standard_normal(len(knots) + KNOTS)
    smooth = sosfilt(butter(2, bandwidth, fs=rate, output='sos'), noise)[KNOTS:]
    return _normal(run, CubicSpline(knots, smooth))


def _normal(run: Run, raw: Callable[[FloatArray], FloatArray]) -> Excitation:
    """Scale to 1 at the most over the run, and let it in smoothly."""
    def gated(t: FloatArray) -> FloatArray:
        return -np.expm1(-(t / RISE) ** 2) * raw(t)

    largest = float(np.abs(gated(np.linspace(0, run.duration, 20001))).max())
    return lambda t: gated(t) / largest


KINDS: Mapping[str, Callable[..., Excitation]] = {
    kind.__name__: kind for kind in (sine, multisine, chirp, steps, random)}


@dataclass(frozen=True)
class Spec:
    """An excitation as a user writes it, KIND:NAME=VALUE,...

    Attributes:
        amplitude: largest value; None: by the response, see `make`.
        offset: constant added; None: see `make`.
    """

    kind: str
    settings: Mapping[str, float]
    amplitude: float | None = None
    offset: float | None = None


def parse(text: str) -> Spec:
    """Read KIND:NAME=VALUE,...; every kind takes an amplitude and an offset too.

    Raises:
        UserError: no such kind, no such setting of it, a value that is no number above zero, or
            a range that is empty.
    """
    kind, _, rest = text.partition(':')
    if kind not in KINDS:
        raise UserError(f'no excitation {kind!r}; there are {", ".join(KINDS)}')
    _, *parameters = inspect.signature(KINDS[kind]).parameters.values()
    known = [parameter.name for parameter in parameters]
    settings = settings_of(text, rest)
    if not np.isfinite(list(settings.values())).all():
        raise UserError(f'excitation {text!r}: every value must be finite')
    amplitude, offset = settings.pop('amplitude', None), settings.pop('offset', None)
    for name, value in settings.items():
        if name not in known:
            raise UserError(f'excitation {text!r}: {kind} has no {name}; it has '
                            f'{", ".join([*known, "amplitude", "offset"])}')
        if value <= 0:
            raise UserError(f'excitation {text!r}: {name} must be above zero')
    used = {parameter.name: parameter.default for parameter in parameters} | settings
    if used.get('lines', 1) < 1:
        raise UserError(f'excitation {text!r}: lines must be 1 at least')
    for low, high in ORDERED:
        if low in used and used[low] > used[high]:
            raise UserError(f'excitation {text!r}: {low}, {used[low]:g}, must not be above '
                            f'{high}, {used[high]:g}')
    return Spec(kind, settings, amplitude, offset)


def burst(begin: float, length: float, frequency: float, amplitude: float) -> Excitation:
    """Make a vibration [Hz] that swells and fades within `length` seconds from `begin` on [s]."""
    def vibration(t: FloatArray) -> FloatArray:
        share = np.clip((t - begin) / length, 0.0, 1.0)
        return amplitude * np.sin(np.pi * share) ** 2 * np.sin(2 * np.pi * frequency * t)

    return vibration


def parse_burst(text: str) -> tuple[str, Excitation]:
    """Read INPUT:begin=2,length=0.2,frequency=60,amplitude=1e-3.

    Raises:
        UserError: a setting is missing, unknown, or no number above zero.
    """
    name, _, rest = text.partition(':')
    settings = settings_of(text, rest)
    wanted = [*inspect.signature(burst).parameters]
    if sorted(settings) != sorted(wanted):
        raise UserError(f'burst {text!r}: it takes {", ".join(wanted)}, each once')
    if not all(0 < value < np.inf for value in settings.values()):
        raise UserError(f'burst {text!r}: every value must be finite, and above zero')
    return name, burst(**settings)


def settings_of(text: str, rest: str) -> dict[str, float]:
    """Split the `rest` of a text, NAME=VALUE,..., into numbers.

    Raises:
        UserError: it is not of that form.
    """
    try:
        return {name.strip(): float(value) for name, value in
                (part.split('=') for part in rest.split(',') if part)}
    except ValueError:
        raise UserError(f'{text!r}: after the colon should stand NAME=NUMBER,NAME=NUMBER'
                        ) from None


def make(spec: Spec, run: Run, laws: Laws, column: int, largest: float, sample_time: float,
         middle: float = 0.0) -> Excitation:
    """Make an excitation.

    Args:
        spec: what the user asks for.
        run: what it is drawn for.
        laws: the plant's, which give the amplitude where the user gives none: the one with which
            this input by itself makes the linear plant's output reach `largest`.
        column: of this input.
        largest: see `laws`, in the output's unit.
        sample_time: of the series [s].
        middle: output about which that is, in its unit; where the user gives neither amplitude
            nor offset, the input has the offset that holds it.

    Raises:
        UserError: hardly more than zero is left of it at the samples.
    """
    shape = KINDS[spec.kind](run, **spec.settings)
    amplitude, offset = spec.amplitude, spec.offset or 0.0
    if amplitude is None:
        t = sample_time * np.arange(round(run.duration / sample_time), dtype=np.float64)
        u = shape(t)
        if not np.abs(u).max() > LEAST:
            raise UserError(f'excitation {spec.kind}: at samples {sample_time:g} s apart, over '
                            f'{run.duration:g} s, hardly more than zero is left of it')
        _, y, _ = lsim((laws.A, laws.B[:, [column]], laws.C, laws.D[:, [column]]), u, t)
        amplitude = largest / np.abs(y).max()
        if middle:          # the range of the output is that of the input, at rest
            gain = laws.D[0, column] - laws.C[0] @ np.linalg.solve(laws.A, laws.B[:, column])
            amplitude = min(amplitude, largest / abs(gain))
            offset = float(middle / gain) if spec.offset is None else offset
        amplitude = float(f'{amplitude:.3g}')
    return lambda t: offset + amplitude * shape(t)
