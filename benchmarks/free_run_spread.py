"""How far the errors of the estimates alone move the free run of a traced model.

    python -m benchmarks.free_run_spread train --test test --plant positioning

Traces, draws parameters from the normal distribution of the fit, with its standard errors and
correlations, and runs each draw freely over the test part. If the error of another model is among
those of the draws, then the recording that was fitted does not say which of the two is better.
"""
from __future__ import annotations

import argparse
from dataclasses import replace
import math

import numpy as np

import hydro_twin as ht
from hydro_twin.arrays import FloatArray
from hydro_twin.errors import UserError
from hydro_twin.model import Model
from hydro_twin.predictors.scores import errors_in
from hydro_twin.progress import progress
from hydro_twin.result import Factor

DRAWS = 400
QUANTILES = (0.01, 0.05, 0.25, 0.5, 0.75, 0.95)


def moved(model: Model, factor: Factor, change: FloatArray) -> Model:
    """Add a change to the parameters that the factor names."""
    values, effects = dict(model.values), list(model.effects)
    for (name, index), added in zip(factor.names, change, strict=True):
        if index is None:
            values[name] += added
        else:
            placed = effects[index]
            at = [parameter.name for parameter in placed.effect.parameters].index(name)
            changed = placed.values[at] + added
            effects[index] = replace(placed, values=(*placed.values[:at], changed,
                                                     *placed.values[at + 1:]))
    return replace(model, values=values, effects=tuple(effects))


def main() -> None:
    """Trace and draw."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('bag', nargs='+')
    parser.add_argument('--test', nargs='+', required=True)
    parser.add_argument('--plant', required=True)
    parser.add_argument('--config')
    args = parser.parse_args()
    data = ht.read(args.bag, args.plant, test=args.test, config=args.config)
    traced = ht.trace(data, show=progress).result
    model, factor = traced.after, traced.factor
    test = {'test': data.test or data.recording}
    root = np.linalg.pinv(factor.R)         # covariance = root root'
    rng = np.random.default_rng(0)
    errors = []
    for _ in range(DRAWS):
        change = root @ rng.standard_normal(len(factor.R))
        try:
            error = errors_in(moved(model, factor, change).predictor(), test, 'free_run')['test']
        except UserError:
            error = math.nan
        errors.append(error)
    unit = traced.plant.output.unit
    print(f'as fitted: {errors_in(model.predictor(), test, "free_run")["test"]:.4g} {unit}')
    print(f'of {DRAWS} draws {np.isnan(errors).sum()} do not run; quantiles of the others:')
    for share, value in zip(QUANTILES, np.nanquantile(errors, QUANTILES), strict=True):
        print(f'  {share:.2f}: {value:.4g} {unit}')


if __name__ == '__main__':
    main()
