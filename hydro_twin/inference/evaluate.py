"""From the evidence of a trace to its result: judged, estimated, run and drawn, each once."""
from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.linalg import null_space

from hydro_twin.arrays import FloatArray
from hydro_twin.fitting.estimates import combination_estimates, fitted_model
from hydro_twin.fitting.fit import Fit
from hydro_twin.fitting.horizon import horizon_errors, horizon_windows
from hydro_twin.fitting.identifiability import Identifiability
from hydro_twin.fitting.noise import estimate_noise
from hydro_twin.fitting.outputs import sensor_rms
from hydro_twin.fitting.unknowns import get, label
from hydro_twin.inference.evidence import Evidence
from hydro_twin.inference.probability import of_verdict
from hydro_twin.inference.shape import shape_of
from hydro_twin.inference.structure import is_drift_significant
from hydro_twin.inference.verdict import is_structured, named_effects, P_STRUCTURE, verdict_of
from hydro_twin.model import Model
from hydro_twin.parallel import in_processes
from hydro_twin.predictors.analytical import Analytical
from hydro_twin.predictors.predictor import MODES, OBSERVER
from hydro_twin.predictors.scores import (
    Errors,
    errors_in,
    first_scored,
    persistence,
    predict,
    rms,
)
from hydro_twin.recording.series import Recording, Series
from hydro_twin.result import (
    Burst,
    Factor,
    FoundCurve,
    OutputErrors,
    Remainder,
    Run,
    SeriesErrors,
    TraceResult,
)

PARTS = ('test', 'train')
Predictions = dict[str, list[FloatArray]]       # mode -> of each series; test part, then training


def result_of(evidence: Evidence) -> TraceResult:
    """Evaluate all that is said of a trace.

    Every series is predicted once by each model and mode, and errors, figures and tables are
    those of these predictions.
    """
    series = [one for part in PARTS for one in evidence.recordings[part].series]
    fits = {'before': evidence.before, 'after': evidence.final}
    same = evidence.final is evidence.before
    before = _predictions(evidence.before, series)
    predicted = {'before': before,
                 'after': before if same else _predictions(evidence.final, series)}
    errors = {when: _errors(evidence, predicted[when])
              | (horizon_errors(fit.candidate, evidence.recordings) if evidence.by_horizon else {})
              for when, fit in fits.items()}
    known = {'before': evidence.before.identifiability(),
             'after': evidence.known or evidence.final.identifiability()}
    models = {when: fitted_model(fit, known[when],
                                 {'before': errors['before'], 'after': errors[when]})
              for when, fit in fits.items()}
    observed = list(in_processes(partial(_observed, evidence.recordings),
                                 [models['before']] if same else [*models.values()]))
    models = {'before': observed[0], 'after': observed[-1]}
    effects, verdict = named_effects(evidence), verdict_of(evidence)
    nothing, law_unknown = of_verdict(verdict, effects, evidence.exceeds_noise)
    curve = evidence.curve
    return TraceResult(
        plant=evidence.plant, verdict=verdict, nothing=nothing, law_unknown=law_unknown,
        evidence_left=evidence.evidence_left, tested=evidence.tested,
        horizon=_longest_window(evidence) if evidence.by_horizon else None,
        before=models['before'], after=models['after'],
        combinations={when: combination_estimates(fits[when], known[when]) for when in fits},
        factor=_factor(fits['after'], known['after']), effects=effects,
        shapes=tuple(shape_of(evidence.final, effect.placed, evidence.fitted)
                     for effect in effects),
        curve=None if curve is None else FoundCurve(
            curve.placed, curve.gain, curve.p_value, curve.others),
        best_named=evidence.best_named,
        improvement=evidence.improvement, undetectable=evidence.undetectable,
        remainder=_remainder(evidence),
        outputs=_by_output(evidence, models), series=_by_series(evidence, predicted),
        runs=_runs(evidence, series, predicted),
        persistence=persistence(evidence.recordings['test'], evidence.plant), noise=evidence.floor,
        memory=evidence.memory,
        fails=evidence.fails, parts=(len(evidence.train), len(evidence.test)))


def _longest_window(evidence: Evidence) -> float:
    """Return how long [s] a window of the error over a horizon is at most."""
    sample_time = evidence.after.candidate.sample_time
    windows = horizon_windows(evidence.test, evidence.plant, sample_time)
    return sample_time * max(len(window.measured) for window in windows)


def _factor(fit: Fit, known: Identifiability) -> Factor:
    """Marginalise the information factor over the timing; the parameters are in their units."""
    unknowns = {label(unknown): unknown for unknown in fit.unknowns}
    columns = [(k, unknowns[name]) for k, name in enumerate(known.coordinates)
               if unknowns[name].owner != 'timing']
    kept = [k for k, _ in columns]
    scale = [get(fit.candidate, unknown) if unknown.log else unknown.scale
             for _, unknown in columns]
    others = np.delete(known.factor, kept, axis=1)
    left = null_space(others.T).T if others.size else np.eye(len(known.factor))
    return Factor(
        tuple((unknown.name, int(unknown.owner) if unknown.owner else None)
              for _, unknown in columns),
        left @ known.factor[:, kept] / scale, left @ known.step)


def _predictions(fit: Fit, series: Sequence[Series]) -> Predictions:
    predictor = Analytical(fit.candidate)
    return {mode: predict(predictor, series, mode) for mode in MODES}


def _observed(recordings: Mapping[str, Recording], model: Model) -> Model:
    """Give a model the noise that its observer needs, and the errors of that."""
    noise = estimate_noise(model, recordings['train'].series)
    if noise is None:
        return model
    model = replace(model, noise=noise)
    errors = errors_in(Analytical(model), recordings, OBSERVER)
    return model.with_record(errors={
        **model.errors, 'after': {**model.errors['after'], OBSERVER: errors}})


def _residuals(evidence: Evidence, predicted: Predictions, mode: str
               ) -> dict[str, list[FloatArray]]:
    """Measured minus predicted, scored samples only, of each series of each part."""
    left = iter(predicted[mode])
    return {part: [(one[evidence.plant.output.name] - next(left))[
        first_scored(one, evidence.plant, mode):] for one in evidence.recordings[part].series]
        for part in PARTS}


def _errors(evidence: Evidence, predicted: Predictions) -> Errors:
    """Score a model on both parts; nan where a run diverges."""
    residuals = {mode: _residuals(evidence, predicted, mode) for mode in MODES}
    return {mode: {part: rms(np.concatenate(residuals[mode][part])) for part in ('train', 'test')}
            for mode in MODES}


def _by_series(evidence: Evidence, predicted: dict[str, Predictions]) -> tuple[SeriesErrors, ...]:
    """Score each series; training and test part together where both are cut from it.

    A part too short to be scored has no error.
    """
    train, test = (evidence.recordings[part].series for part in ('train', 'test'))
    sources = [one.source for one in train]
    both = len(train) == len(test) and all(
        one.whole is not None and one.whole is other.whole
        for one, other in zip(train, test, strict=False))
    rows: list[dict[str, Errors]] = [
        {when: {mode: {} for mode in MODES} for when in predicted} for _ in sources]
    for when, predictions in predicted.items():
        for mode in MODES:
            residuals = _residuals(evidence, predictions, mode)
            for part in ('train', 'test') if both else ('train',):
                for row, error in zip(rows, residuals[part], strict=True):
                    if len(error):
                        row[when][mode][part] = rms(error)
    return tuple(SeriesErrors(source, **row) for source, row in zip(sources, rows, strict=True)
                 if all(np.isfinite(error) for errors in row.values()
                        for parts in errors.values() for error in parts.values()))


def _by_output(evidence: Evidence, models: Mapping[str, Model]) -> dict[str, OutputErrors]:
    """Score the free runs on the output and on each sensor."""
    plant = evidence.plant
    left = {**evidence.final.noise, plant.output.name: evidence.floor}
    errors = {when: {plant.output.name: model.errors['after']['free_run']}
              | (sensor_rms(Analytical(model), evidence.recordings) if len(left) > 1 else {})
              for when, model in models.items()}
    units = {signal.name: signal.unit for signal in (plant.output, *plant.sensors)}
    return {name: OutputErrors(units[name], errors['before'][name], errors['after'][name], noise)
            for name, noise in left.items()}


def _runs(evidence: Evidence, series: Sequence[Series], predicted: dict[str, Predictions]
          ) -> tuple[Run, ...]:
    """Put the free runs beside what was measured, of each series long enough to be scored."""
    labels = [f'{name} {k + 1}' for name, part in (('test', 'test'), ('training', 'train'))
              for k in range(len(evidence.recordings[part].series))]
    return tuple(
        Run(label, one, one[evidence.plant.output.name],
            first_scored(one, evidence.plant, 'free_run'), before, after)
        for label, one, before, after in zip(
            labels, series, predicted['before']['free_run'], predicted['after']['free_run'],
            strict=True) if len(one) > first_scored(one, evidence.plant, 'free_run'))


def _remainder(evidence: Evidence) -> Remainder:
    return Remainder(
        error=evidence.after.error, white=evidence.white,
        lines=evidence.lines, bursts=_bursts(evidence), depends_on=evidence.depends_on,
        drifts=is_drift_significant(evidence.drifts), by_ports=evidence.by_ports,
        exceeds_any_noise=evidence.exceeds_any_noise,
        held_out_ratio=evidence.held_out_ratio if evidence.is_larger_held_out else None,
        structured=is_structured(evidence, P_STRUCTURE))


def _bursts(evidence: Evidence) -> tuple[Burst, ...]:
    """Say when the bursts come, in seconds from the begin of their bag."""
    parts, candidate = [*evidence.train, *evidence.test], evidence.after.candidate
    sample_time = candidate.sample_time
    begin = {bag: min(part.start for part in parts if part.source == bag)
             for bag in {part.source for part in parts}}
    found = []
    for burst in evidence.bursts:
        part = parts[burst.stretch]
        at = 1e-9 * (part.start - begin[part.source]) + candidate.start_up * sample_time
        found.append(Burst(part.source, at + burst.begin * sample_time,
                           at + burst.end * sample_time))
    return tuple(sorted(found, key=lambda burst: (burst.bag, burst.begin)))
