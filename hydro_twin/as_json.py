"""Results as what JSON can say."""
from __future__ import annotations

import math


def as_json(value: object) -> object:
    """Turn a result into what JSON can say; a number that is not finite becomes None."""
    match value:
        case None | bool() | int() | str():
            return value
        case float():
            return float(value) if math.isfinite(value) else None
        case dict():
            return {str(key): as_json(item) for key, item in value.items()}
        case list() | tuple():
            return [as_json(item) for item in value]
        case _ if hasattr(value, 'tolist'):   # numpy, without importing it
            return as_json(value.tolist())
    return str(value)
