"""What was found: effects with their probabilities, and curves without a name."""
from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from hydro_twin.arrays import FloatArray
from hydro_twin.effects import Placed

AMBIGUOUS_DELTA_BIC = 10.0  # difference in BIC below which the data do not decide between two laws
NEAR_DELTA_BIC = 100.0  # difference in BIC up to which a rival is near
CERTAIN_PROBABILITY = 0.99    # probability from which a law is certain


@dataclass(frozen=True)
class Improvement:
    """How much smaller a mean square error became.

    Attributes:
        relative: 1 - after / before.
        low, high: its bootstrap interval at 98 %.
    """

    relative: float
    low: float
    high: float


@dataclass(frozen=True)
class FreeCurve:
    """A free curve over a signal: knots, what is added there, its standard error, each (K,)."""

    label: str
    knots: FloatArray
    added: FloatArray
    std_error: FloatArray


@dataclass(frozen=True)
class Shape:
    """What an effect adds at its port, as it acts in the run and as free curves have it.

    Attributes:
        signal: that is shown over, a signal at the port or 'value'.
        reads: how many signals the law depends on.
        x, added: some samples of the signal and of what the law adds, (N,).
        curves: fitted without the law; one, or one for a rising and one for a falling signal.
    """

    signal: str
    reads: int
    x: FloatArray
    added: FloatArray
    curves: tuple[FreeCurve, ...]


@dataclass(frozen=True)
class Profile:
    """The output error over the first parameter of an effect, all else as fitted.

    Attributes:
        values, errors: (K,), RMS on what was fitted.
        error: at the value that was fitted.
    """

    values: FloatArray
    errors: FloatArray
    error: float


@dataclass(frozen=True)
class OverTime:
    """How a parameter of the plant went over time.

    Attributes:
        time: [s] from the start of the recording, (K,).
        values: of the parameter by its law, (K,).
        free: of the parameter as the recording shows them at some times, without any law.
    """

    time: FloatArray
    values: FloatArray
    free: FreeCurve


@dataclass(frozen=True)
class NamedEffect:
    """An effect that the plant lacks.

    Attributes:
        index: of the effect among those of the model after.
        placed: the effect with its values.
        p_value: of what it adds to the others, for all that was tried.
        share: of the mean square error without it that it takes off.
        law_unknown: probability that the law is none of the library's.
        probability: that this is the law; where it sits may still be open.
        ports: probability of each port at which it may sit, given the effect; its own first.
        other_ports: where it would explain as much.
        rivals: (id, difference in BIC) of other effects in its place, nearest first.
        given: parameter of the effect -> parameters of the plant that the recording does not
            determine: the value holds only for these as they stand.
    """

    index: int
    placed: Placed
    p_value: float
    share: float
    law_unknown: float
    probability: float
    ports: Mapping[str, float]
    other_ports: tuple[str, ...]
    rivals: tuple[tuple[str, float], ...]
    given: Mapping[str, tuple[str, ...]]

    @property
    def id(self) -> str:
        """Its id."""
        return self.placed.effect.id

    @property
    def port(self) -> str:
        """The name of its port."""
        return self.placed.port.name

    @property
    def certain(self) -> bool:
        """Whether the data single out this law."""
        return self.probability >= CERTAIN_PROBABILITY

    @property
    def close(self) -> tuple[str, ...]:
        """The ids of the rivals between which and it the data do not decide."""
        return tuple(name for name, distance in self.rivals if distance < AMBIGUOUS_DELTA_BIC)


@dataclass(frozen=True)
class FoundCurve:
    """A curve without a name: the last effect of the model after.

    Attributes:
        improvement: of the mean square error on held-out data, against the model without it.
        p_value: of what it adds, for all that was tried.
        others: (curve at another place, difference in BIC), nearest first.
    """

    placed: Placed
    improvement: Improvement
    p_value: float
    others: tuple[tuple[Placed, float], ...]


@dataclass(frozen=True)
class BestNamed:
    """The best explanation by named effects, where a free curve took their place.

    Attributes:
        effects: with their values.
        held_out_error: RMS of what they leave of the test part, but for its initial states.
    """

    effects: tuple[Placed, ...]
    held_out_error: float
