"""What an effect is: a law on one port of a plant, with parameters, bounds and perhaps memory."""
from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
import math
from typing import Any

from hydro_twin.arrays import FloatArray
from hydro_twin.plants.plant import Plant, Port

TINY = 1e-12            # stands for a signal that is zero throughout, so that it can divide


@dataclass(frozen=True)
class EffectParameter:
    """A parameter of an effect.

    Attributes:
        unit: in terms of the port: 'value', 'velocity', ... stand for the unit of the port's
            value and of the signals there; anything else stands for itself.
        lower, upper: physical range.
        log: whether a search moves in its logarithm (then lower is above zero).
        refinement: the neutral value, at which the simple law fixes the parameter. None: part of
            the simple law.
        unreached: of a limit, the value that stands for no limit; a limit that the recording never
            reached is not identified. None: not a limit.
        fixed: whether it is set from the recording, and no fit moves it.
        scales: power of the effect's strength to which it is proportional: 1 for an amplitude, -1
            for a supply pressure, below which a flow falls; 0 if it does not measure the strength,
            or if, as for the width of a dead zone, the fit has a local minimum at each cluster of
            turning points.
    """

    name: str
    meaning: str
    unit: str
    lower: float
    upper: float
    log: bool = True
    refinement: float | None = None
    unreached: float | None = None
    fixed: bool = False
    scales: int = 0


@dataclass(frozen=True)
class Span:
    """What one recording reaches at a port under the current model.

    Attributes:
        ranges: least and largest value that leaves the port, in each part: what a law remembers
            does not reach from one part into another.
        signal_ranges: least and largest value of each signal there.
        measured: least and largest output in all that was recorded, but for a hundredth of it.
        lasting: for how many samples in a row the value is near its least or its largest.
        duration: of the longest part [s].
        added_swing: how far what the effect adds goes from its least to its largest in one part;
            found by a slow run, so only where it is asked for.
    """

    ranges: Sequence[tuple[float, float]]
    signal_ranges: Mapping[str, tuple[float, float]]
    measured: tuple[float, float]
    sample_time: float
    lasting: int
    duration: float = math.inf
    added_swing: Callable[[], float] = float

    @property
    def signals(self) -> dict[str, float]:
        """Largest magnitude of each signal, never quite zero."""
        return {name: max(-low, high, TINY) for name, (low, high) in self.signal_ranges.items()}

    @property
    def travel(self) -> dict[str, float]:
        """How far each signal goes, from its least value to its largest."""
        return {name: high - low for name, (low, high) in self.signal_ranges.items()}

    @property
    def low(self) -> float:
        """Least value that leaves the port."""
        return min(low for low, _ in self.ranges)

    @property
    def high(self) -> float:
        """Largest value that leaves the port."""
        return max(high for _, high in self.ranges)

    @property
    def swing(self) -> float:
        """How far the value goes from its least to its largest in one part."""
        return max(high - low for low, high in self.ranges)

    @property
    def value(self) -> float:
        """Largest magnitude of the port's value."""
        return max(abs(self.low), abs(self.high), TINY)


ADDED = 'added'         # what an implicit effect added last


@dataclass(frozen=True)
class Quantity:
    """What can be shown of an effect while it is at work, as a sum.

    Attributes:
        name: in a word.
        unit: in terms of the port, as that of a parameter.
        weights: parameters of the effect -> weight of the port's value or a signal there, of what
            it keeps, by index, and of `ADDED`.
    """

    name: str
    unit: str
    weights: Callable[[tuple[float, ...]], Mapping[str | int, float]]


Starts = Sequence[tuple[float, ...]]


@dataclass(frozen=True)
class Course:
    """How a parameter of the plant goes over time, as a factor on its last value.

    Attributes:
        factor: parameters of the effect, one stamp or K [s] -> the factor, (K,).
        slopes: the same -> its derivatives by the P parameters, (P, K).
        interval: parameters of the effect -> the stamps [s] between which it changes.
    """

    factor: Callable[[tuple[float, ...], float | FloatArray], FloatArray]
    slopes: Callable[[tuple[float, ...], FloatArray], FloatArray]
    interval: Callable[[tuple[float, ...]], tuple[float, float]]


@dataclass(frozen=True)
class Effect:
    """A law on a port that a linear plant lacks.

    The law is a compiled function law(v, s, p, z, h, c, z_next) -> value:
        v: value of the port; s: the signals it reads; p: its parameters;
        z: its memory at the start of the step of h seconds (h = 0: evaluate, nothing moves);
        c: rise of the first signal by the end of the step for a unit added to the value;
        z_next: where it writes its memory at the end of the step.

    Attributes:
        id: effects at different ports may share one, as `lag` at a command and at a sensor.
        kinds: the kinds of port it may sit on.
        reads: the signals of the port it reads, in the order of s; 'value' for what reaches it.
        unit_read: unit that the first signal must have; '' for any.
        memory: how many numbers it keeps.
        keeps_by: the parameter that, at zero, makes it leave them unused; '' if there is none.
        swings: how many of the first of them may have any value at the start of a recording, as
            position and speed of a load that swings, if its last parameter is not zero.
        starts: what the recording reaches -> sets of parameters to begin a search at.
        excitation: what a recording must hold to show it, as advice to a person.
        beyond_reach: whether it may hide beyond what a recording reaches, as a limit does.
        confounded: whether re-estimated parameters of the plant can imitate it so well that its
            score means nothing; then its first start, the gentlest, is always searched from.
        refined: what the recording reaches and the parameters of the simple law -> sets of
            parameters to begin at with refinements let in.
        plain: parameters -> those of the simple law that is nearest; None: without refinements.
        distinguishable: what the recording reaches and parameters -> whether such a recording
            separates them from something simpler; where it does not, the effect is not tried.
        passes_for: what the recording reaches -> the id of the simpler effect that it would look
            like there, and '' where it would show for what it is.
        implicit: the law gets its first signal as it would be at the end of the step without the
            effect, and returns what holds there: for forces that jump with the velocity.
        shifts: a pure delay of these inputs ('held' or 'all'), which has no law.
        course: of a parameter of the plant, which is the port; there is no law.
        explains: whether it explains what it adds; a curve that is merely found does not.
        linear: whether it is linear dynamics, which no curve over a signal shows.
        dynamic: whether these act on a signal on its way, so that they look like a delay.
        periodic: whether it repeats with what it reads: a run that is half a period off meets it
            in the wrong phase.
        shows: what an observer publishes of it.
        simpler: id of an effect that is chosen instead unless this one is clearly better.
        countable: whether its name takes an article in a sentence, as 'a lag', but 'friction'.
    """

    id: str
    title: str
    kinds: tuple[str, ...]
    parameters: tuple[EffectParameter, ...]
    starts: Callable[[Span], Starts]
    excitation: str
    beyond_reach: bool = False
    confounded: bool = False
    refined: Callable[[Span, tuple[float, ...]], Starts] | None = None
    plain: Callable[[tuple[float, ...]], tuple[float, ...]] | None = None
    distinguishable: Callable[[Span, tuple[float, ...]], bool] | None = None
    passes_for: Callable[[Span], str] | None = None
    law: Callable[..., Any] | None = None
    reads: tuple[str, ...] = ()
    unit_read: str = ''
    memory: int = 0
    keeps_by: str = ''
    swings: int = 0
    implicit: bool = False
    shifts: str = ''
    course: Course | None = None
    explains: bool = True
    linear: bool = False
    dynamic: bool = False
    periodic: bool = False
    simpler: str = ''
    countable: bool = True
    shows: tuple[Quantity, ...] = ()

    def __post_init__(self) -> None:
        if len(self.reads) > 2 or (self.implicit and not self.reads):
            raise ValueError(f'{self.id}: a law reads two signals at most, an implicit one at '
                             'least one')

    def fits(self, port: Port) -> bool:
        """Whether the effect may sit on this port."""
        return (port.kind in self.kinds and all(name in port.signals for name in self.reads)
                and self.unit_read in ('', *(port.signals[name] for name in self.reads[:1])))

    def unit(self, parameter: EffectParameter, port: Port) -> str:
        """Write the unit of a parameter at a port."""
        # A law may have a position of its own where the port has none, as that of a load.
        moved = port.signals.get('velocity', '').removesuffix('/s')
        names = {'value': port.unit, 'position': moved, **port.signals}
        parts = parameter.unit.split('/')
        written = [names.get(part.removesuffix('^2'), part.removesuffix('^2'))
                   + ('^2' if part.endswith('^2') else '') for part in parts]
        return '/'.join(f'({part})' if ' ' in part and k else part
                        for k, part in enumerate(written))


@dataclass(frozen=True)
class Placed:
    """An effect on a port of a plant, with values for its parameters in their order.

    Compiled laws read them without a check, so that it is made here.

    Raises:
        ValueError: too few values or too many, or a port that lacks a signal that the law reads.
    """

    effect: Effect
    port: Port
    values: tuple[float, ...]

    def __post_init__(self) -> None:
        if len(self.values) != len(self.effect.parameters):
            raise ValueError(f'{self.effect.id} takes {len(self.effect.parameters)} values, '
                             f'not {len(self.values)}')
        for name in self.effect.reads:
            if name != 'value' and name not in self.port.signals:
                raise ValueError(f'{self.effect.id} reads the {name}, of which the '
                                 f'{self.port.name} has none')

    @property
    def key(self) -> tuple[str, str]:
        """Id and port: what identifies it in a model."""
        return self.effect.id, self.port.name

    @property
    def named(self) -> dict[str, float]:
        """Parameter values by name."""
        names = (parameter.name for parameter in self.effect.parameters)
        return dict(zip(names, self.values, strict=True))

    @property
    def in_use(self) -> list[tuple[EffectParameter, float]]:
        """Parameters with their values, but for refinements and limits that are neutral."""
        return [(p, value) for p, value in zip(self.effect.parameters, self.values, strict=True)
                if value not in (p.refinement, p.unreached)]

    @property
    def swings(self) -> int:
        """How many numbers say how it swings at the start of a recording."""
        return self.effect.swings if self.effect.swings and self.values[-1] else 0

    @property
    def remembers(self) -> bool:
        """Whether what it gives depends on what it keeps."""
        by = self.effect.keeps_by
        return self.effect.memory > 0 and (not by or self.named[by] != 0.0)

    @property
    def branches(self) -> bool:
        """Whether what it adds depends on how the signal came to its value, as in a loop."""
        return self.remembers and not self.effect.implicit

    def scaled(self, strength: float) -> Placed:
        """Make the effect so many times as strong, within its bounds, if it has a strength."""
        return replace(self, values=tuple(
            min(max(value * strength**p.scales, p.lower), p.upper) if p.scales else value
            for p, value in zip(self.effect.parameters, self.values, strict=True)))


def sites(effect: Effect, plant: Plant) -> list[Port]:
    """List the ports of a plant on which the effect may sit, its parameters among them."""
    return [port for port in (*plant.ports, *plant.parameter_ports) if effect.fits(port)]
