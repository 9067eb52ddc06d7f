"""Message types by name."""
from __future__ import annotations

import importlib
from typing import Any

from hydro_twin.errors import UserError


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
