"""The page of a trace, for a person."""
from __future__ import annotations

import html
import json
from typing import Any

from hydro_twin.residual.trace import Trace
from hydro_twin.residual.verdict import Verdict


def page(trace: Trace, verdict: Verdict, summary: dict[str, Any],
         provenance: dict[str, Any]) -> str:
    """Write the report as one self-contained page."""
    return (f'<!doctype html><meta charset="utf-8"><title>{trace.plant.title}: '
            f'{verdict.kind}</title><h1>{html.escape(summary["says"])}</h1>'
            f'<pre>{html.escape(json.dumps(summary, indent=2))}</pre>'
            f'<pre>{html.escape(json.dumps(provenance, indent=2))}</pre>')
