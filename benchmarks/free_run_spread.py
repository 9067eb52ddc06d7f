"""How far the errors of the estimates alone move the free run of a traced model.

    python -m benchmarks.free_run_spread train --test test --plant positioning

Traces, draws parameters from the normal distribution of the fit, with its standard errors and
correlations, and runs each draw freely over the test part. If the error of another model is among
those of the draws, then the recording that was fitted does not say which of the two is better.
"""
from __future__ import annotations

import argparse
import math

import numpy as np

import hydro_twin as ht
from hydro_twin.errors import UserError
from hydro_twin.fitting.unknowns import get, put, unknowns_of
from hydro_twin.model import Model
from hydro_twin.predictors.scores import errors_in
from hydro_twin.progress import progress

DRAWS = 400
QUANTILES = (0.01, 0.05, 0.25, 0.5, 0.75, 0.95)


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
    test = data.test
    assert test is not None
    traced = ht.trace(data, show=progress).result
    model, factor = traced.after, traced.factor
    by_name = {(unknown.name, unknown.owner): unknown for unknown in unknowns_of(model)}
    unknowns = [by_name[name, '' if index is None else str(index)]
                for name, index in factor.names]
    fitted = np.array([get(model, unknown) for unknown in unknowns])
    root = np.linalg.pinv(factor.R)         # covariance = root root'
    rng = np.random.default_rng(0)

    def free_run_error(drawn: Model) -> float:
        return errors_in(drawn.predictor(), {'test': test}, 'free_run')['test']

    errors = []
    for _ in range(DRAWS):
        drawn = put(model, unknowns, fitted + root @ rng.standard_normal(len(factor.R)))
        try:
            error = free_run_error(drawn)
        except UserError:
            error = math.nan
        errors.append(error)
    unit = traced.plant.output.unit
    print(f'as fitted: {free_run_error(model):.4g} {unit}')
    print(f'of {DRAWS} draws {np.isnan(errors).sum()} do not run; quantiles of the others:')
    for share, value in zip(QUANTILES, np.nanquantile(errors, QUANTILES), strict=True):
        print(f'  {share:.2f}: {value:.4g} {unit}')


if __name__ == '__main__':
    main()
