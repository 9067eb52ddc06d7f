"""What a plant is: linear laws joined at named ports, with parameters, units and bounds."""
from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
import math
from typing import Any

import numpy as np
import numpy.typing as npt

from hydro_twin.arrays import FloatArray
from hydro_twin.errors import ModelError
from hydro_twin.plants.equations import Equations, rates_at, rows_of

PARAMETER = 'parameter'     # kind of port that a parameter is
ROUNDING = 1e-6         # of the largest response of a sensor: two that differ by less are the same
INTEGRATES = 1e-9       # of the largest pole: a smaller one is zero but for rounding

# Parameters in their order, (P, d), real or complex; constants by name; sample time [s]
# -> coefficients of y(k-1..k-n), then of u(k..k-n) of every input, (P, n + (n + 1) m).
ClosedForm = Callable[[npt.NDArray[Any], Mapping[str, float], float], npt.NDArray[Any]]


@dataclass(frozen=True)
class Parameter:
    """A physical parameter of a plant.

    Attributes:
        lower, upper: the box in which an optimiser looks for it.
        minimum, maximum: the physical range; a model with a value outside it is refused.
        least_samples: least value of a time constant in a fit, in sample times: a shorter one does
            not show, and time steps are too long for what effects add beside it.
    """

    name: str
    meaning: str
    unit: str
    lower: float
    upper: float
    minimum: float
    maximum: float
    least_samples: float = 0.0

    def check(self, value: float) -> None:
        """Refuse a value outside the physical range.

        Raises:
            ModelError: it is, or it is not a number.
        """
        if not self.minimum <= value <= self.maximum:
            raise ModelError(f'{self.name} = {value:g} {self.unit} is outside its physical range '
                             f'{self.minimum:g} to {self.maximum:g}')


@dataclass(frozen=True)
class Constant:
    """A quantity of the rig that no recording can show, with its default."""

    name: str
    meaning: str
    unit: str
    value: float


@dataclass(frozen=True)
class Signal:
    """An input, the output or a sensor; a held input is a command, kept until the next one."""

    name: str
    meaning: str
    unit: str
    held: bool = False


@dataclass(frozen=True)
class Port:
    """A place between two laws, at which an effect may act.

    Attributes:
        name: what reports call it; ports of one name are the same place seen in two quantities.
        kind: what sort of quantity passes here; an effect sits on kinds, not on plants.
        unit: unit of that quantity.
        signals: what an effect may read here beside the value: name -> unit.
    """

    name: str
    kind: str
    unit: str
    meaning: str
    signals: Mapping[str, str] = field(default_factory=dict, hash=False)


@dataclass(frozen=True)
class Laws:
    """The linear laws of a plant for one set of parameters.

    With states x, inputs u and d, what the effects add to the value of each port:
        x' = A x + B u + E d
        value of port p = (port_x x + port_u u + port_d d)[p] + d[p],  port_d strictly lower
        signals at the ports, port after port = signal_x x + signal_u u + signal_d d
        what the sensors read = sensor_x x + sensor_u u + sensor_d d
    The output is the value of the last port.
    """

    A: FloatArray
    B: FloatArray
    E: FloatArray
    port_x: FloatArray
    port_u: FloatArray
    port_d: FloatArray
    signal_x: FloatArray
    signal_u: FloatArray
    signal_d: FloatArray
    sensor_x: FloatArray
    sensor_u: FloatArray
    sensor_d: FloatArray

    @property
    def C(self) -> FloatArray:
        """Output row for the states, shape (1, n), in front what the laws have in front."""
        return self.port_x[..., -1:, :]

    @property
    def D(self) -> FloatArray:
        """Output row for the inputs, shape (1, m), in front what the laws have in front."""
        return self.port_u[..., -1:, :]

    def of(self, k: int) -> Laws:
        """Return those of one set of parameters, of laws that were written for several."""
        return Laws(*(getattr(self, block.name)[k] for block in fields(self)))


@dataclass(frozen=True)
class Plant:
    """One kind of actuator.

    Attributes:
        sample_time: [s], of a job where neither a configuration, nor a recording, nor a model says
            otherwise (`recording.clock`).
        inputs: in the order of the columns of B.
        output: what the plant is known by.
        sensors: what else can be measured, used where it is there: `port.sensor(NAME, value)` in
            the equations.
        equations: its linear laws, as a function of parameters `p`, states `x`, inputs `u` and
            `port`, which passes a value through the next port; returns the rate of each state.
        combinations: groups of parameters that act only together, whatever is recorded, as the
            product of powers that can be known: ({'V_m': 1, 'beta_e': -1}, ...).
        at_rest: the states whose rate is taken as zero at the first sample; with the measured
            output they give the state at which a run starts.
        commanded: the states that only the commands move, by a stable lag, as the opening of a
            valve: what no command asked for, none of them was at.
        start_up: time [s] at the start of a series in which the measured output shows the state at
            the start, and a run from rest forgets most of it. Not scored in a free run.
        horizon: longest time [s] for which a run can follow: less than for ever near an unstable
            equilibrium, which a recording shows.
        output_range: least and largest output that there physically is, where that is bounded.
        output_scale: a typical large output, by which networks scale theirs.
        closed_form: the coefficients of the difference equation, eq. 1 of [B19], where there are
            formulae for them; otherwise they come from the matrices, which is slower.
        finest: the shortest sample time [s] that a recording of this plant is worth: a faster one
            is read at this. 0 stands for `sample_time`.
    """

    name: str
    title: str
    sample_time: float
    inputs: tuple[Signal, ...]
    output: Signal
    states: tuple[str, ...]
    parameters: tuple[Parameter, ...]
    constants: tuple[Constant, ...]
    ports: tuple[Port, ...]
    equations: Equations
    at_rest: tuple[str, ...]
    start_up: float
    combinations: tuple[Mapping[str, int], ...] = field(default=(), hash=False)
    output_scale: float = 1.0
    closed_form: ClosedForm | None = None
    commanded: tuple[str, ...] = ()
    finest: float = 0.0
    horizon: float = math.inf
    output_range: tuple[float, float] | None = None
    sensors: tuple[Signal, ...] = ()

    @property
    def signals(self) -> tuple[Signal, ...]:
        """All inputs, then the output: what must be there."""
        return (*self.inputs, self.output)

    @property
    def parameter_ports(self) -> tuple[Port, ...]:
        """The parameters as places at which an effect may act, as a drift does."""
        return tuple(Port(p.name, PARAMETER, p.unit, p.meaning) for p in self.parameters)

    @property
    def order(self) -> int:
        """Number of states, which is the order of the difference equation."""
        return len(self.states)

    @cached_property
    def integrates(self) -> bool:
        """Whether the output never forgets an earlier state: the plant has a pole at zero.

        Then a long free run accumulates the errors of the laws, and the earliest weigh most.
        """
        poles = np.abs(np.linalg.eigvals(self.laws(self.constant_values() | self.middle()).A))
        return bool(poles.min() <= INTEGRATES * poles.max())

    def laws(self, values: Mapping[str, float]) -> Laws:
        """Write the equations as matrices.

        Args:
            values: parameters and constants by name; for K sets of them at once, those that
                differ of shape (K, 1), and every matrix has K in front.

        Raises:
            ModelError: the equations do not fit the states and ports declared.
        """
        n, m = self.order, len(self.inputs)
        rows = rows_of(self.equations, values, self.states, [u.name for u in self.inputs],
                       [port.name for port in self.ports],
                       [tuple(port.signals) for port in self.ports],
                       [sensor.name for sensor in self.sensors])
        return Laws(*(block for matrix in rows
                      for block in (matrix[..., :n], matrix[..., n:n + m], matrix[..., n + m:])))

    def signal_row(self, port: Port, name: str) -> int:
        """Find the row of a signal at a port, 'value' for its own value.

        Among the rows of all ports' values and then of their signals, port after port.
        """
        k = self.ports.index(port)
        if name == 'value':
            return k
        before = sum(len(other.signals) for other in self.ports[:k])
        return len(self.ports) + before + list(port.signals).index(name)

    def middle(self) -> dict[str, float]:
        """Return the value of each parameter in the middle of its search box, a geometric mean."""
        return {p.name: (p.lower * p.upper) ** 0.5 for p in self.parameters}

    def check_equations(self) -> None:
        """Check that the equations are linear and fit what is declared.

        Raises:
            ModelError: they give other rates, ports or signals, or they are not linear.
        """
        values = {c.name: c.value for c in self.constants} | self.middle()
        laws = self.laws(values)
        n, m, width = self.order, len(self.inputs), self.order + len(self.inputs) + len(self.ports)
        v = np.random.default_rng(0).uniform(1.0, 2.0, width)
        rates = rates_at(self.equations, values, dict(zip(self.states, v, strict=False)),
                         {u.name: v[n + k] for k, u in enumerate(self.inputs)},
                         v[n + m:])
        wanted = np.hstack([laws.A, laws.B, laws.E]) @ v
        given = np.array([rates[name] for name in self.states])
        if not np.allclose(wanted, given, rtol=1e-9, atol=1e-9 * float(np.abs(wanted).max())):
            raise ModelError(f'the equations of {self.name} are not linear: what is not belongs '
                             'in an effect')

    def start_samples(self, sample_time: float) -> int:
        """Count the samples of the start-up at a sample time [s].

        At least twice as many as a one-step prediction needs, so that noise is averaged out of
        the states that they show.
        """
        return max(2 * (self.order + 1), round(self.start_up / sample_time))

    def constant_values(self, given: Mapping[str, float] | None = None) -> dict[str, float]:
        """Merge constants given by the user into the defaults.

        Raises:
            ModelError: a name that is not a constant of this plant, or a value not above zero.
        """
        values = {constant.name: constant.value for constant in self.constants}
        for name, value in (given or {}).items():
            if name not in values:
                known = ', '.join(values) or 'none'
                hint = (f'; {name} is a parameter, which refit --fix {name}={value:g} holds'
                        if name in (p.name for p in self.parameters) else '')
                raise ModelError(f'{self.name} has no constant {name}; it has {known}{hint}')
            if not (np.isfinite(value) and value > 0):
                raise ModelError(f'constant {name} = {value}: must be a positive number')
            values[name] = float(value)
        return values

    def holding(self, known: Mapping[str, float]) -> Plant:
        """Take parameters as known: they become constants, and a fit moves the others only.

        Args:
            known: values of parameters by name.

        Raises:
            ModelError: one is not a parameter of this plant, or outside its physical range, or
                none is left to fit.
        """
        parameters = {p.name: p for p in self.parameters}
        for name, value in known.items():
            if name not in parameters:
                raise ModelError(f'{self.name} has no parameter {name}; it has '
                                 f'{", ".join(parameters)}')
            parameters[name].check(value)
        free = tuple(p for p in self.parameters if p.name not in known)
        if not free:
            raise ModelError(f'all parameters of {self.name} are held; none is left to fit')
        rest = [{name: power for name, power in combination.items() if name not in known}
                for combination in self.combinations]
        return replace(
            self, parameters=free, closed_form=None if known else self.closed_form,
            combinations=tuple(c for c in rest if len(c) > 1),
            constants=(*self.constants, *(
                Constant(p.name, p.meaning, p.unit, known[p.name])
                for p in self.parameters if p.name in known)))

    def seen_by(self, sensors: Iterable[str]) -> Plant:
        """Return the plant with only those combinations that these sensors do not separate.

        Args:
            sensors: names of what is measured beside the output.
        """
        rows = [[sensor.name for sensor in self.sensors].index(name) for name in sensors]
        kept = tuple(c for c in self.combinations if not self._parted(c, rows))
        return self if kept == self.combinations else replace(self, combinations=kept)

    def _parted(self, combination: Mapping[str, int], rows: Sequence[int]) -> bool:
        """Whether a sensor separates the members of a combination.

        Its response changes when two members change, and their product of powers does not.
        """
        values = self.constant_values() | self.middle()
        (first, power), *others = combination.items()
        laws = self.laws(values)
        poles = np.abs(np.linalg.eigvals(laws.A))
        frequencies = np.maximum(poles, 1e-3 * poles.max())

        def response(laws: Laws) -> npt.NDArray[np.complex128]:
            return np.array([laws.sensor_x[rows] @ np.linalg.solve(
                1j * w * np.eye(self.order) - laws.A, laws.B) + laws.sensor_u[rows]
                for w in frequencies])

        before = response(laws)
        largest = np.abs(before).max(axis=(0, 2), keepdims=True, initial=0.0)
        return any((np.abs(response(self.laws(values | {
            first: values[first] * 2.0 ** (1.0 / power),
            name: values[name] * 2.0 ** (-1.0 / other)})) - before) > ROUNDING * largest).any()
            for name, other in others)

    def check(self, parameters: Mapping[str, float]) -> None:
        """Refuse a set of parameters that is not this plant's or not physical.

        Raises:
            ModelError: a parameter is missing, unknown, or outside its physical range.
        """
        names = {parameter.name for parameter in self.parameters}
        if unknown := sorted(set(parameters) - names):
            raise ModelError(f'{self.name} has no parameter {", ".join(unknown)}')
        for p in self.parameters:
            if p.name not in parameters:
                raise ModelError(f'parameter {p.name} of {self.name} is missing')
            p.check(parameters[p.name])
