"""A run of an observer with gains that are known, and so without its covariance."""
from __future__ import annotations

from hydro_twin.compiled import compiled
from hydro_twin.predictors.kernel import advance, LIMIT, output


@compiled
def run_with_gains(  # type: ignore[no-untyped-def]
        step, x, z, work, inputs, measured, gains, y, first, last):
    """Fill y with the prediction of the samples first <= k < last, and take in what is measured.

    State x and memory z are those of the sample before the first, and are moved, by the gains (M,
    n + memory) times the innovation. A run that diverges is left at nan from there on.
    """
    n = len(x)
    # As in `kernel.run`: one function for the step of both takes a run a quarter longer.
    for k in range(first, last):
        if k == 0:
            y[k] = output(step, x, z, work, inputs, k, False)
        else:
            y[k] = advance(step, x, z, work, inputs, k, False)
        if not abs(y[k]) < LIMIT:
            y[k:] = float('nan')
            return
        innovation = measured[k] - y[k]
        if innovation == innovation:
            for i in range(n):
                x[i] += gains[k, i] * innovation
            for i in range(len(z)):
                z[i] += gains[k, n + i] * innovation
