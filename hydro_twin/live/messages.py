"""Message types by name: their Python classes, how they are laid out, and the numbers in them."""
from __future__ import annotations

from collections.abc import Iterator
from functools import cache
import importlib
import re
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys import get_typestore, Stores
from rosbags.typesys.store import Typestore

from hydro_twin.errors import UserError
from hydro_twin.recording.cdr import DTYPES
from hydro_twin.recording.signals import NAME_FIELDS, SignalMap, split_index

BASES = {'boolean': 'bool', 'float': 'float32', 'double': 'float64'}   # of IDL -> of .msg files


@cache
def typestore() -> Typestore:
    """Return the definitions of the message types that are known, those of Jazzy at first."""
    return get_typestore(Stores.ROS2_JAZZY)


def message_class(name: str) -> Any:
    """Find the Python class of a message type such as sensor_msgs/msg/JointState.

    Raises:
        UserError: its package is not installed, or does not have it.
    """
    package, _, short = name.partition('/msg/')
    try:
        return getattr(importlib.import_module(f'{package}.msg'), short)
    except (ImportError, AttributeError):
        raise UserError(f'message type {name} is not installed: source the workspace that has '
                        f'{package}') from None


def learn(name: str) -> None:
    """Take the definition of a message type from its class, where `typestore` lacks it.

    Raises:
        UserError: it is not installed.
    """
    store = typestore()
    if name in store.fielddefs:
        return
    message = message_class(name)
    fields = [(field, _described(slot)) for field, slot in
              zip(message.get_fields_and_field_types(), message.SLOT_TYPES, strict=True)]
    store.register({name: ([], fields)})


def _described(slot: Any) -> Any:
    """Turn the type of a field, an object of rosidl_parser.definition, into one of rosbags."""
    if hasattr(slot, 'value_type'):
        item = _described(slot.value_type)
        if hasattr(slot, 'size'):
            return Nodetype.ARRAY, (item, slot.size)
        return Nodetype.SEQUENCE, (item, getattr(slot, 'maximum_size', 0))
    if hasattr(slot, 'namespaces'):
        name = '/'.join([*slot.namespaces, slot.name])
        learn(name)
        return Nodetype.NAME, name
    if hasattr(slot, 'typename'):
        return Nodetype.BASE, (BASES.get(slot.typename, slot.typename), 0)
    kind = 'wstring' if 'WString' in type(slot).__name__ else 'string'
    return Nodetype.BASE, (kind, getattr(slot, 'maximum_size', 0))


def check_field(where: SignalMap) -> None:
    """Refuse a field that no message of its type can have.

    Raises:
        UserError: there is no such number in the type, or the type is not installed.
    """
    learn(where.type)
    fields = list(_fields(where.type, ''))
    numbers = {path: size for path, base, size in fields if base in DTYPES}
    path = re.sub(r'\[[^\[\]]*\]', '[]', where.field)
    head, index = split_index(where.field)
    if path not in numbers:
        raise UserError(f'{where.type} has no number {where.field!r}; it has '
                        f'{", ".join(numbers)}')
    if index is None:
        return
    owner = path.removesuffix('[]').rpartition('.')[0]
    if index.isdecimal():
        if 0 < numbers[path] <= int(index):
            raise UserError(f'{where.type} has {numbers[path]} numbers in {head!r}, so no '
                            f'{where.field}')
    elif not {f'{owner}.{name}[]'.removeprefix('.') for name in NAME_FIELDS} & {
            path for path, base, _ in fields if base == 'string'}:
        raise UserError(f'{where.type} names no joints beside {head!r}: write {head}[0]')


def _fields(msgtype: str, prefix: str) -> Iterator[tuple[str, str, int]]:
    """Walk a type; yield path, type and size of each field, arrays as PATH[].

    The size is that of an array, or the most that a sequence may hold; 0 if that is not limited.
    """
    fields: Any = typestore().fielddefs[msgtype][1]
    for name, (kind, about) in fields:
        path, size = f'{prefix}{name}', 0
        if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            (kind, about), size = about
            path += '[]'
        if kind == Nodetype.NAME:
            yield from _fields(about, f'{path}.')
        else:
            yield path, about[0], size
