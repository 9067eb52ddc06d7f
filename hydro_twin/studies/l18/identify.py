"""Identify a valve servo both ways, as published and by least squares, and put them together."""
from __future__ import annotations

from collections.abc import Callable, Mapping
import json
from pathlib import Path
from typing import Any

from hydro_twin.arrays import FloatArray
from hydro_twin.as_json import as_json
from hydro_twin.files import write_whole
from hydro_twin.model import Estimate
from hydro_twin.recording.series import Recording
from hydro_twin.report.picture import write_picture
from hydro_twin.studies.l18.direct import fit_free_run, fit_one_step
from hydro_twin.studies.l18.figures import draw_fit, residual_figures
from hydro_twin.studies.l18.linear_loop import LoopParameters, PUBLISHED
from hydro_twin.studies.l18.published_method import fit_published, predict_rivals, PublishedFit


def identify(bag: Path, recording: Recording, k_1: float, seed: int, folder: Path,
             done: Callable[[], object] = lambda: None) -> dict[str, Any]:
    """Identify a recording both ways; writes identification.json and the figures 8 to 11.

    Args:
        bag: where the recording comes from.
        recording: with the signals command and opening.
        k_1: correction coefficient [1], taken as known.
        seed: of the networks.
        folder: where to write.
        done: called after each of four fits.

    Returns:
        What identification.json holds.

    Raises:
        DataError: the recording does not allow it.
    """
    free_run = fit_free_run(recording, k_1)
    done()
    one_step = fit_one_step(recording, k_1)
    done()
    published = fit_published(recording, k_1, seed)
    done()
    rivals = predict_rivals(published.data, seed)
    done()
    result = {'bag': str(bag), **report(free_run, one_step, published, rivals, k_1)}
    folder.mkdir(parents=True, exist_ok=True)
    for name, figure in draw_fit(published, rivals).items():
        write_picture(figure, folder / f'{name}.png')
    write_whole(folder / 'identification.json',
                json.dumps(as_json(result), indent=2, allow_nan=False).encode())
    return result


def report(free_run: Mapping[str, Estimate], one_step: Mapping[str, Estimate],
           published: PublishedFit, rivals: Mapping[str, FloatArray], k_1: float
           ) -> dict[str, Any]:
    """Gather all fits, and the paper's figures, for JSON."""
    def estimates(fit: Mapping[str, Estimate]) -> dict[str, Any]:
        return {name: {'value': e.value, 'unit': 's', 'std_error': e.std_error,
                       'identifiable': e.identifiable} for name, e in fit.items()}

    def reading(parameters: LoopParameters | str) -> dict[str, Any]:
        if isinstance(parameters, str):
            return {'parameters': None, 'reason': parameters}
        return {'parameters': parameters._asdict()}

    return {
        'k_1': k_1,
        'paper': PUBLISHED._asdict(),
        'least_squares': {'free_run': estimates(free_run), 'one_step': estimates(one_step)},
        'network': {
            'weights': {'v': published.weights.v, 'n': published.weights.n},
            'nearest': {**reading(published.nearest.parameters),
                        'at_edge': published.nearest.at_edge},
            'exact': reading(published.exact), 'printed': reading(published.printed),
            'errors': published.errors(rivals), 'correlation': residual_figures(published)},
    }
