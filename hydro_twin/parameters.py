"""The parameters of the node: what each is for, and where the signals of a plant are found."""
from __future__ import annotations

from typing import Any

from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.node import Node
from rclpy.parameter import Parameter

from hydro_twin.plants import Plant
from hydro_twin.recording.signals import default_config, load_parameters, signal_maps, SignalMap


def declare_parameters(node: Node) -> None:
    """Declare the parameters that do not hang on the plant."""
    def text(description: str, **limits: Any) -> ParameterDescriptor:
        return ParameterDescriptor(description=description, **limits)

    node.declare_parameter('model', '', text(
        'model file that ~/prediction comes from; may be set while the node runs'))
    node.declare_parameter('models', Parameter.Type.STRING_ARRAY, text(
        'more model files, side by side on ~/NAME/prediction: NAME=PATH or PATH'))
    node.declare_parameter('mode', 'one_step', text(
        'one_step: from measured outputs up to the sample before; free_run: without them',
        additional_constraints='one_step or free_run'))
    node.declare_parameter('wait', 0.1, text(
        'how long a late input is waited for before its last value is held [s]',
        floating_point_range=[FloatingPointRange(from_value=0.0, to_value=10.0)]))
    node.declare_parameter('sample_time', None, text(
        'clock of the job [s], for the offline verbs that read the same file; the node takes that '
        'of its model, and refuses another', dynamic_typing=True))
    node.declare_parameter('autostart', True, text(
        'configure and activate at start, without a lifecycle manager'))


class SignalParameters:
    """The parameters `signals.*`, which are those of one plant at a time."""

    def __init__(self, node: Node) -> None:
        """Declare nothing yet."""
        self._node = node
        self._plant = ''

    def read(self, plant: Plant) -> dict[str, SignalMap]:
        """Read the signal map of a plant; declare it first, unless it was the last one's too.

        Raises:
            UserError: a value that no signal map can have.
            ParameterException: a value of another type.
        """
        node = self._node
        if self._plant != plant.name:
            for key in node.get_parameters_by_prefix('signals'):
                node.undeclare_parameter(f'signals.{key}')
            self._plant = plant.name
        defaults = load_parameters(default_config(plant.name))
        values = {}
        for signal in plant.signals:
            for attribute in ('topic', 'type', 'field', 'scale', 'offset'):
                key = f'signals.{signal.name}.{attribute}'
                if not node.has_parameter(key):
                    node.declare_parameter(key, defaults[key], ParameterDescriptor(
                        description=f'{attribute} of the {signal.meaning} [{signal.unit}]',
                        dynamic_typing=attribute in ('scale', 'offset')))
                values[key] = node.get_parameter(key).value
        return signal_maps(values, [signal.name for signal in plant.signals],
                           'parameters of the node')
