"""The parameters of the node in ROS: declared, checked, and where the signals of a plant are."""
from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node
from rclpy.parameter import Parameter

from hydro_twin.live.settings import Setting, SETTINGS
from hydro_twin.plants import Plant, plant_named
from hydro_twin.plants.plant import Signal
from hydro_twin.recording.signals import (
    default_config,
    is_named,
    load_parameters,
    signal_maps,
    SignalMap,
)

OFFLINE = ('constants.', 'sample_time')   # of the same file, for the offline verbs
PREFIX = 'signals.'
NEUTRAL = {'scale': 1.0, 'offset': 0.0}         # of a signal whose default says nothing of these


def declare_parameters(node: Node, settings: Sequence[Setting] = SETTINGS) -> None:
    """Declare the parameters that do not hang on the plant."""
    for setting in settings:
        descriptor = ParameterDescriptor(
            description=setting.description, read_only=setting.read_only,
            additional_constraints=' or '.join(setting.choices))
        if setting.bounds:
            low, high = setting.bounds
            if isinstance(setting.default, int):
                descriptor.integer_range = [IntegerRange(from_value=int(low), to_value=int(high))]
            else:
                descriptor.floating_point_range = [FloatingPointRange(
                    from_value=low, to_value=high)]
                descriptor.dynamic_typing = True    # so that 1 will do for 1.0
        node.declare_parameter(
            setting.name,
            list(setting.default) if isinstance(setting.default, tuple) else setting.default,
            descriptor)


def objection(name: str, value: Any, settings: Sequence[Setting] = SETTINGS) -> str:
    """Say why a parameter cannot have a value, or ''."""
    for setting in settings:
        if setting.name == name:
            return setting.objection(value)
    return ''


class SignalParameters:
    """The parameters `signals.*`, which are those of one plant at a time."""

    def __init__(self, node: Node, overrides: Mapping[str, Parameter]) -> None:
        """Declare nothing yet; `overrides` are the values that the node was started with."""
        self._node = node
        self._overrides = overrides
        self._plant: Plant | None = None
        self._declared: list[str] = []
        self._signals: list[Signal] = []

    def declare(self, name: str) -> None:
        """Declare the signals of a plant instead of those of another.

        Raises:
            UserError: there is no such plant.
            ParameterException: a value that the node was started with is of another type.
        """
        node, plant = self._node, plant_named(name)
        if plant is self._plant:
            return
        self._plant = None
        while self._declared:
            node.undeclare_parameter(self._declared.pop())
        defaults = load_parameters(default_config(name))
        given = any(key.startswith(PREFIX) for key in self._overrides)
        self._signals = [*plant.signals, *(
            sensor for sensor in plant.sensors
            if is_named(sensor.name, self._overrides if given else defaults))]
        for signal in self._signals:
            for attribute in ('topic', 'type', 'field', 'scale', 'offset'):
                key = f'{PREFIX}{signal.name}.{attribute}'
                default = defaults.get(key, NEUTRAL.get(attribute))
                node.declare_parameter(key, default, ParameterDescriptor(
                    description=f'{attribute} of the {signal.meaning} [{signal.unit}]',
                    dynamic_typing=attribute in ('scale', 'offset')))
                self._declared.append(key)
        self._plant = plant

    def read(self, plant: Plant) -> dict[str, SignalMap]:
        """Read the signal map of a plant.

        Raises:
            UserError: a value that no signal map can have, or one for a signal that the plant
                does not have among those that the node was started with.
            ParameterException: a value of another type.
        """
        self.declare(plant.name)
        values = {key: given.value for key, given in self._overrides.items()
                  if key.startswith(PREFIX)}
        values |= {key: self._node.get_parameter(key).value for key in self._declared}
        return signal_maps(values, [signal.name for signal in self._signals],
                           'parameters of the node')

    def unknown(self, name: str) -> str:
        """Say why there is no such signal parameter, or ''."""
        if not name.startswith(PREFIX) or self._node.has_parameter(name):
            return ''
        if self._plant is None:
            return f"{name}: of which plant? Set the parameter 'model' or 'plant' first"
        return (f'{name}: the signals of {self._plant.name} are '
                f'{", ".join(signal.name for signal in self._signals)}, each with topic, '
                'type, field, scale, offset')

    def ignored(self) -> list[str]:
        """List what the node was started with and does not know, once it is active."""
        return [name for name in self._overrides
                if not self._node.has_parameter(name) and not name.startswith(OFFLINE)]
