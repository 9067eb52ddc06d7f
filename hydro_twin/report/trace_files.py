"""Writes what a trace gives: report.json, report.html and model.yaml in a folder."""
from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from hydro_twin.errors import UserError
from hydro_twin.model import write_model
from hydro_twin.report.page import page
from hydro_twin.report.summary import model_of, summarise
from hydro_twin.residual.trace import Trace
from hydro_twin.residual.verdict import judge


def write_files(trace: Trace, folder: Path, provenance: dict[str, Any]) -> dict[str, Any]:
    """Write the three files of a trace, each whole or not at all; returns the report object.

    Raises:
        UserError: the folder cannot be written.
    """
    verdict = judge(trace)
    summary = summarise(trace, verdict)
    html = page(trace, verdict, summary, provenance)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_whole(folder / 'report.json', json.dumps(summary, indent=2, allow_nan=False))
        write_whole(folder / 'report.html', html)
    except OSError as error:
        raise UserError(f'{folder}: cannot be written ({error.strerror})') from error
    write_model(model_of(trace, verdict, provenance), folder / 'model.yaml')
    return summary


def write_whole(path: Path, text: str) -> None:
    """Write a text file so that it is either the old one or the new one, never a part."""
    part = path.with_name(f'.{path.name}.{os.getpid()}')
    part.write_text(text, encoding='utf-8')
    part.replace(path)
