"""The result of a trace as one finished value: what was found, and all that a report shows of it.

Nothing here fits or runs a model, and nothing is left to be computed from one.
"""
from __future__ import annotations

from hydro_twin.result.effects import (
    AMBIGUOUS_DELTA_BIC,
    BestNamed,
    CERTAIN_PROBABILITY,
    FoundCurve,
    FreeCurve,
    Improvement,
    NamedEffect,
    NEAR_DELTA_BIC,
    OverTime,
    Profile,
    Shape,
)
from hydro_twin.result.remainder import Burst, Dependence, Line, Remainder, TIME
from hydro_twin.result.trace_result import (
    Errors,
    Factor,
    Memory,
    OutputErrors,
    Run,
    SeriesErrors,
    TestPart,
    TraceResult,
    Undetectable,
    VerdictKind,
)

__all__ = [
    'AMBIGUOUS_DELTA_BIC',
    'CERTAIN_PROBABILITY',
    'NEAR_DELTA_BIC',
    'TIME',
    'BestNamed',
    'Burst',
    'Dependence',
    'Errors',
    'Factor',
    'FoundCurve',
    'FreeCurve',
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
    'TestPart',
    'TraceResult',
    'Undetectable',
    'VerdictKind',
]
