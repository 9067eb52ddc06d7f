"""Linear equations written with named symbols, and the matrices read off them."""
from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.typing as npt

from hydro_twin.errors import ModelError

# A linear combination of states, inputs and what effects add to the ports: its coefficients,
# shape (n + m + P,). Complex where a derivative is taken by the complex step.
Linear = npt.NDArray[Any]


class Ports:
    """The ports of a plant, passed in the order in which the plant declares them."""

    def __init__(self, names: Sequence[str], signals: Sequence[Sequence[str]],
                 added: Linear) -> None:
        self._names, self._signals, self._added = names, signals, added
        self.values: list[Linear] = []      # before an effect at the port itself adds to them
        self.signals: list[Linear] = []
        self.sensors: dict[str, Linear] = {}

    def __call__(self, name: str, value: Linear, **signals: Linear) -> Linear:
        """Pass a value through the next port.

        Args:
            name: of the port, as declared.
            value: what reaches it.
            signals: what an effect may read there, by the names declared.

        Returns:
            The value with what effects add to it.

        Raises:
            ModelError: the next port has another name, or other signals.
        """
        k = len(self.values)
        if (k == len(self._names) or name != self._names[k]
                or signals.keys() != set(self._signals[k])):
            raise ModelError(f'port {name} ({", ".join(signals) or "no signals"}) is not the next '
                             f'of those declared, {", ".join(self._names)}')
        self.values.append(value)
        for signal in self._signals[k]:
            self.signals.append(signals[signal])
        passed: Linear = value + self._added[k]
        return passed

    def sensor(self, name: str, value: Linear) -> None:
        """Say what a sensor beside the output reads."""
        self.sensors[name] = value


class _Point:
    """The ports at one point, where what effects add are numbers."""

    def __init__(self, added: npt.NDArray[np.float64]) -> None:
        self._added = iter(added)

    def __call__(self, _: str, value: Any, **__: Any) -> Any:
        return value + next(self._added)

    def sensor(self, name: str, value: Any) -> None:
        """Nothing: no rate hangs on a sensor."""


# (parameters and constants, states, inputs, ports) -> the rate of each state by its name
Equations = Callable[[SimpleNamespace, SimpleNamespace, SimpleNamespace, Any],
                     Mapping[str, Any]]


def rows_of(equations: Equations, values: Mapping[str, float], states: Sequence[str],
            inputs: Sequence[str], ports: Sequence[str], signals: Sequence[Sequence[str]],
            sensors: Sequence[str] = ()) -> tuple[Linear, Linear, Linear, Linear]:
    """Read the coefficients off linear equations, exactly.

    Args:
        equations: as a plant defines them.
        values: parameters and constants by name; for K plants at once, of shape (K, 1).
        states: names of the n states.
        inputs: names of the m inputs.
        ports: names of the P ports.
        signals: names of the signals at each port, S in all.
        sensors: names of the sensors beside the output.

    Returns:
        Coefficients of the states' rates, shape (n, n + m + P); of the ports' values, each
        without what effects add at the port itself, (P, n + m + P); of the signals there,
        (S, n + m + P); of what the sensors read, (sensors, n + m + P). For K plants with K in
        front.

    Raises:
        ModelError: the equations do not give these rates, ports, signals and sensors.
    """
    n, m = len(states), len(inputs)
    unit = np.eye(n + m + len(ports))
    passed = Ports(ports, signals, unit[n + m:])
    rates = equations(SimpleNamespace(**values),
                      SimpleNamespace(**dict(zip(states, unit, strict=False))),
                      SimpleNamespace(**dict(zip(inputs, unit[n:], strict=False))), passed)
    if rates.keys() != set(states) or len(passed.values) != len(ports):
        raise ModelError(f'the equations give the rates of {", ".join(rates)} and '
                         f'{len(passed.values)} ports; declared are {", ".join(states)} and '
                         f'{len(ports)} ports')
    if passed.sensors.keys() != set(sensors):
        raise ModelError(f'the equations give the sensors {", ".join(passed.sensors)}; declared '
                         f'are {", ".join(sensors)}')
    of_states = [rates[name] for name in states]
    of_sensors = [passed.sensors[name] for name in sensors]
    shape = np.broadcast_shapes(*(row.shape for row in [
        *of_states, *passed.values, *passed.signals, *of_sensors]))
    return (_stacked(of_states, shape), _stacked(passed.values, shape),
            _stacked(passed.signals, shape), _stacked(of_sensors, shape))


def _stacked(rows: Sequence[Linear], shape: tuple[int, ...]) -> Linear:
    """Put rows one above the other, (..., rows, width)."""
    stacked: Linear = np.zeros((*shape[:-1], len(rows), shape[-1]),
                               np.result_type(float, *rows))
    for k, row in enumerate(rows):
        stacked[..., k, :] = row
    return stacked


def rates_at(equations: Equations, values: Mapping[str, float], states: Mapping[str, float],
             inputs: Mapping[str, float], added: npt.NDArray[np.float64]) -> Mapping[str, Any]:
    """Evaluate equations at one point, as numbers.

    Args:
        equations: as a plant defines them.
        values: parameters and constants by name.
        states: their values.
        inputs: their values.
        added: by effects, at each port.
    """
    return equations(SimpleNamespace(**values), SimpleNamespace(**states),
                     SimpleNamespace(**inputs), _Point(added))
