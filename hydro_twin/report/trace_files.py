"""Writes the result of a trace into a folder: report, page, figures, series and models."""
from __future__ import annotations

from collections.abc import Sequence
import csv
import io
import json
import math
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from hydro_twin.as_json import as_json
from hydro_twin.errors import UserError
from hydro_twin.model import write_model
from hydro_twin.parallel import beside
from hydro_twin.report.chart import Illustration
from hydro_twin.report.figures import illustrations
from hydro_twin.report.page import page
from hydro_twin.report.summary import summarise
from hydro_twin.result import TraceResult

FIGURES = 'figures'
AT_ONCE = 4096          # rows of the table that are written together


def write_files(result: TraceResult, folder: Path, provenance: dict[str, Any]) -> dict[str, Any]:
    """Write all files of a trace; none is replaced before all are made.

    These are report.json, report.html, model.yaml, series.csv, figures/*.png and, where something
    was added to the model, before.yaml, the model without it.

    Returns:
        The report object.

    Raises:
        UserError: the folder cannot be written.
    """
    summary = summarise(result)
    drawn = illustrations(result)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with (beside(_pictures, drawn) as pictures,
              TemporaryDirectory(dir=folder, prefix='.') as hidden):
            new = Path(hidden) / 'new'
            (new / FIGURES).mkdir(parents=True)
            (new / 'report.json').write_text(json.dumps(
                as_json(summary), indent=2, allow_nan=False), encoding='utf-8')
            (new / 'report.html').write_text(page(result, summary, provenance, drawn),
                                             encoding='utf-8')
            write_series(result, new / 'series.csv')
            write_model(result.after.with_record(provenance=provenance), new / 'model.yaml')
            if result.changed:
                write_model(result.before.with_record(provenance=provenance),
                            new / 'before.yaml')
            for illustration, picture in zip(drawn, pictures(), strict=True):
                (new / FIGURES / f'{illustration.name}.png').write_bytes(picture)
            if not result.changed:
                (folder / 'before.yaml').unlink(missing_ok=True)
            if (folder / FIGURES).exists():         # those of another trace must not stay
                (folder / FIGURES).replace(Path(hidden) / 'old')
            for path in new.iterdir():
                path.replace(folder / path.name)
    except OSError as error:
        raise UserError(f'{folder}: cannot be written ({error.strerror})') from error
    return summary


def _pictures(drawn: Sequence[Illustration]) -> list[bytes]:
    """Draw the figures: matplotlib is imported only here, as a rule in another process."""
    from hydro_twin.report.drawing import png

    return [png(illustration) for illustration in drawn]


def write_series(result: TraceResult, path: Path) -> None:
    """Write every sample of every part as a row of a CSV table."""
    sample_time, signals = result.before.sample_time, result.plant.signals
    with path.open('w', encoding='utf-8', newline='') as stream:
        writer = csv.writer(stream)
        writer.writerow(['part', 'bag', 'time', *(signal.name for signal in signals),
                         'before', 'after'])
        for run in result.runs:
            time = sample_time * np.arange(len(run.measured))
            columns = np.column_stack([time, *(run.series[signal.name] for signal in signals),
                                       run.before, run.after])
            labels = [text.replace('%', '%%') for text in (run.label, run.series.source)]
            row = io.StringIO()     # as a format of all its numbers: five times as fast as a row
            csv.writer(row).writerow([*labels, *['%.9g'] * columns.shape[1]])
            for some in np.array_split(columns, math.ceil(len(columns) / AT_ONCE)):
                stream.write(row.getvalue() * len(some) % tuple(some.ravel().tolist()))
