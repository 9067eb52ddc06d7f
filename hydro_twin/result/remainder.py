"""What is left: the residual of the plant with all that was found."""
from __future__ import annotations

from dataclasses import dataclass

from hydro_twin.arrays import FloatArray
from hydro_twin.plants import Port

TIME = 'time'           # signal of what depends on no signal, but changes with time


@dataclass(frozen=True)
class Dependence:
    """What a free curve at one port over one signal explains of a residual.

    Attributes:
        signal: 'value' of the port, a signal there, or `TIME` from the first sample [s].
        share: of the residual's power, by cross-validation over blocks of the training part.
        p_value: of the share under noise, for all dependences tried.
        knots, curve: the signal and what is added to the value of the port there.
    """

    port: Port
    signal: str
    share: float
    p_value: float
    knots: FloatArray
    curve: FloatArray


@dataclass(frozen=True)
class Line:
    """A spectral line: frequency [Hz], amplitude in the unit of the residual."""

    frequency: float
    amplitude: float


@dataclass(frozen=True)
class Burst:
    """When much of a residual comes, in seconds from the start of its bag."""

    bag: str
    begin: float
    end: float


@dataclass(frozen=True)
class Remainder:
    """The residual of the plant with all named effects.

    Attributes:
        error: RMS of what was fitted, in the output's unit.
        white: by the test of Ljung and Box.
        bursts: when much of it comes, if seldom, by bag and time.
        depends_on: port signals that explain some of it, the strongest first.
        drifts: whether the parameters drift over the recording.
        by_ports: (share, p-value) of what the port signals predict of it, in any way.
        exceeds_any_noise: whether it is larger than noise can be.
        held_out_ratio: how many times as large it is on held-out data, where that is no chance;
            of the innovations, where the residual was fitted as coloured noise. None: no larger
            than by chance.
        structured: whether any test finds structure in it.
    """

    error: float
    white: bool
    lines: tuple[Line, ...]
    bursts: tuple[Burst, ...]
    depends_on: tuple[Dependence, ...]
    drifts: bool
    by_ports: tuple[float, float]
    exceeds_any_noise: bool
    held_out_ratio: float | None
    structured: bool
