"""The result of a trace as one finished value: what was found, and all that a report shows of it.

Nothing here fits or runs a model, and nothing is left to be computed from one.
"""
from __future__ import annotations

from hydro_twin.result.effects import (
    BestNamed,
    CERTAIN,
    CLOSE,
    FoundCurve,
    FreeCurve,
    Improvement,
    NamedEffect,
    NEAR,
    OverTime,
    Profile,
    Shape,
)
from hydro_twin.result.remainder import Dependence, Line, Remainder, Spell
from hydro_twin.result.trace_result import (
    Errors,
    Factor,
    Hidden,
    Memory,
    OutputErrors,
    Run,
    SERIES,
    SeriesErrors,
    SIXTH,
    THIRD,
    TraceResult,
    VerdictKind,
    WINDOWS,
)

__all__ = [
    'CERTAIN',
    'CLOSE',
    'NEAR',
    'SERIES',
    'SIXTH',
    'THIRD',
    'WINDOWS',
    'BestNamed',
    'Dependence',
    'Errors',
    'Factor',
    'FoundCurve',
    'FreeCurve',
    'Hidden',
    'Improvement',
    'Line',
    'Memory',
    'NamedEffect',
    'OutputErrors',
    'OverTime',
    'Profile',
    'Remainder',
    'Run',
    'SeriesErrors',
    'Shape',
    'Spell',
    'TraceResult',
    'VerdictKind',
]
