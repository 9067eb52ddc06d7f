"""Where each signal of a plant is found in ROS messages: topic, type, field, scale, offset."""
from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
import math
from pathlib import Path
import re
from typing import Any

from hydro_twin.errors import UserError
from hydro_twin.plugins import plugin_files
from hydro_twin.share import share_folder

TYPE = re.compile(r'[a-zA-Z]\w*/msg/[a-zA-Z]\w*')
FIELD = re.compile(r'[a-zA-Z]\w*(\[\d+\])?(\.[a-zA-Z]\w*(\[\d+\])?)*(\[[^\[\]]+\])?')
NAME_FIELDS = ('name', 'joint_names')   # beside arrays with one entry a joint


@dataclass(frozen=True)
class SignalMap:
    """One signal in a stream of messages; its value is scale * field + offset.

    Attributes:
        field: path into the message: `data`, `position[0]`, `effort[rudder]` by the name of the
            joint, `wrench.torque.z`.
    """

    topic: str
    type: str
    field: str
    scale: float = 1.0
    offset: float = 0.0

    def read(self, message: Any) -> float | None:
        """Read the signal from one message, of rclpy or of rosbags.

        Returns:
            The value in the unit of the plant, or None if the joint is not in this message.

        Raises:
            AttributeError, IndexError: the message has no such field, or it is too short.
        """
        path, index = split_index(self.field)
        owner, value = message, message
        for step in path.split('.'):
            owner, (name, element) = value, split_index(step)
            value = getattr(owner, name)
            if element is not None:
                value = value[int(element)]
        if index is not None:
            if not index.isdecimal():
                names = next(list(getattr(owner, n)) for n in NAME_FIELDS if hasattr(owner, n))
                if index not in names:
                    return None
                index = str(names.index(index))
            value = value[int(index)]
        return float(self.of(float(value)))

    def of(self, raw: Any) -> Any:
        """Convert a number or an array from the field's unit to the plant's."""
        # A unit scale is left out so that numbers pass unchanged to the last bit (-0.0 too).
        scaled = raw if self.scale == 1.0 else self.scale * raw
        return scaled if self.offset == 0.0 else scaled + self.offset

    def raw(self, value: Any) -> Any:
        """Convert a number or an array from the plant's unit to the field's."""
        shifted = value if self.offset == 0.0 else value - self.offset
        return shifted if self.scale == 1.0 else shifted / self.scale


def split_index(path: str) -> tuple[str, str | None]:
    """Split the last index off a field path: 'effort[rudder]' -> ('effort', 'rudder')."""
    head, bracket, index = path.rpartition('[')
    return (head, index[:-1]) if bracket and path.endswith(']') else (path, None)


def default_config(plant: str) -> Path:
    """Return the parameter file that comes with a plant: here, or in the package it is from."""
    own = share_folder() / 'config' / f'{plant}.yaml'
    if own.exists():
        return own
    others = [path.parent / 'config' / own.name for path in plugin_files('hydro_twin.plants')]
    return next((path for path in others if path.exists()), own)


def load_signals(plant: str, names: Sequence[str], config: Path | None = None,
                 optional: Sequence[str] = ()) -> dict[str, SignalMap]:
    """Load the signal map of a plant from a ROS parameter file.

    Args:
        plant: name of the plant; what the file leaves out is as in config/PLANT.yaml, if there
            is one.
        names: the signals of the plant.
        config: the file, as the node reads it: `/**: ros__parameters: signals: ...`.
        optional: more signals, each in the map if the file names it.

    Raises:
        UserError: the file cannot be read, is for another plant, or a signal in it is unknown or
            wrong.
    """
    usual = default_config(plant)
    defaults = load_parameters(usual) if config is None or usual.exists() else {}
    given = defaults if config is None else load_parameters(config)
    names = [*names, *(name for name in optional if is_named(name, given))]
    parameters = {key: value for key, value in defaults.items()
                  if not key.startswith('signals.') or key.split('.')[1] in names} | (
                      {} if config is None else given)
    source = str(config or usual)
    if (other := parameters.get('plant') or plant) != plant:
        raise UserError(f'{source}: for the plant {other}, not {plant}')
    # A name without a slash is relative to the namespace of the node, which a bag does not have.
    return {name: replace(where, topic=f'/{where.topic.removeprefix("/")}') for name, where in
            signal_maps(parameters, names, source).items()}


def is_named(signal: str, parameters: Mapping[str, Any]) -> bool:
    """Whether flat parameters say anything of a signal."""
    return any(key.startswith(f'signals.{signal}.') for key in parameters)


def signal_maps(parameters: Mapping[str, Any], names: Sequence[str], source: str,
                ) -> dict[str, SignalMap]:
    """Make the signal map out of flat parameters such as `signals.u_m.topic`.

    Raises:
        UserError: a signal is unknown, incomplete or malformed; `source` is where it came from.
    """
    attributes = [field.name for field in fields(SignalMap)]
    given: dict[str, dict[str, Any]] = {name: {} for name in names}
    for key, value in parameters.items():
        root, _, rest = key.partition('.')
        if root != 'signals' or (value is None and rest in ('', *names)):    # nothing under it
            continue
        if not rest:
            raise UserError(f'{source}: signals must be a map of signals, not {value!r}')
        name, _, attribute = rest.partition('.')
        if name not in given:
            raise UserError(f'{source}: no signal {name!r} in this plant; it has '
                            f'{", ".join(names)}')
        if attribute not in attributes:
            raise UserError(f'{source}: signal {name} has no {attribute!r}; it takes '
                            f'{", ".join(attributes)}')
        given[name][attribute] = value
    return {name: _signal_map(name, values, source) for name, values in given.items()}


def _signal_map(name: str, given: Mapping[str, Any], source: str) -> SignalMap:
    """Check one signal and make it."""
    if missing := [key for key in ('topic', 'type', 'field') if not given.get(key)]:
        raise UserError(f'{source}: signal {name} lacks {", ".join(missing)}')
    topic, type_, field = (str(given[key]) for key in ('topic', 'type', 'field'))
    if not TYPE.fullmatch(type_):
        raise UserError(f'{source}: signal {name}: type {type_!r} should read like '
                        'sensor_msgs/msg/JointState')
    if not FIELD.fullmatch(field):
        raise UserError(f'{source}: signal {name}: field {field!r} should read like data, '
                        'position[0], effort[rudder] or wrench.torque.z')
    scale = number(given.get('scale', 1.0), f'{source}: signal {name}: scale')
    offset = number(given.get('offset', 0.0), f'{source}: signal {name}: offset')
    if scale == 0.0:
        raise UserError(f'{source}: signal {name}: scale must not be zero')
    return SignalMap(topic, type_, field, scale, offset)


def load_constants(plant: str, config: Path | None = None) -> dict[str, float]:
    """Load the constants of the rig (`constants.D_m`) that a parameter file gives.

    Raises:
        UserError: the file cannot be read, or a constant is not a number.
    """
    path = config or default_config(plant)
    return {key.removeprefix('constants.'): number(value, f'{path}: {key}')
            for key, value in load_parameters(path).items() if key.startswith('constants.')}


def number(value: Any, what: str) -> float:
    """Return a finite number, or say that `what` is none.

    Raises:
        UserError: it is not a number, or not finite.
    """
    try:
        result = float(value)   # YAML reads 1e-3, without a point, as text
    except (TypeError, ValueError, OverflowError):
        result = math.nan
    if isinstance(value, bool) or not math.isfinite(result):
        raise UserError(f'{what} must be a finite number, not {value!r}')
    return result


def load_yaml(path: Path) -> Any:
    """Load a YAML file.

    Raises:
        UserError: it cannot be read or is not YAML.
    """
    import yaml

    try:
        return yaml.safe_load(path.read_text(encoding='utf-8'))
    except OSError as error:
        raise UserError(f'{path}: {error.strerror}') from None
    except (yaml.YAMLError, ValueError, RecursionError) as error:   # a date of month 13; nesting
        raise UserError(f'{path} is not YAML: {" ".join(str(error).split())}') from None


def load_parameters(path: Path) -> dict[str, Any]:
    """Load a ROS parameter file as flat parameters: {'signals.u_m.topic': '/command', ...}.

    Raises:
        UserError: it cannot be read, or does not have the shape of a parameter file.
    """
    document = load_yaml(path)
    nodes = document.values() if isinstance(document, dict) else ()
    blocks = [node['ros__parameters'] for node in nodes
              if isinstance(node, dict) and isinstance(node.get('ros__parameters'), dict)]
    if not blocks:
        raise UserError(f"{path} is not a ROS parameter file: '/**:', under it "
                        "'ros__parameters:', under that the parameters")
    return {key: value for block in blocks for key, value in _flat(block, '')}


def _flat(block: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, Any]]:
    """Walk nested parameters, joining their names by dots."""
    for key, value in block.items():
        if isinstance(value, dict):
            yield from _flat(value, f'{prefix}{key}.')
        else:
            yield f'{prefix}{key}', value
