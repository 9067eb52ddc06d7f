"""Standard errors of a fit by output error, in the units of the parameters."""
from dataclasses import replace

import numpy as np
from trace_by_hand import candidate, parts

from hydro_twin.fitting.estimates import combination_estimates, fitted_model
from hydro_twin.inference.search import search


def test_a_standard_error_is_what_repeated_recordings_scatter():
    """Of a parameter and of an effect, over recordings with noise of their own."""
    truth = candidate('positioning', [('bias', 'motor', {'offset': 20.0})])
    start = replace(truth, values={name: 1.1 * value for name, value in truth.values.items()})
    fits = [search(start, parts(truth, 0.4, 0.01, seed), 20) for seed in range(8)]
    models = [fitted_model(fit, fit.identifiability(), {}) for fit in fits]
    for values, errors in (
            ([m.values['M'] for m in models], [m.parameters['M'].std_error for m in models]),
            ([m.effects[0].values[0] for m in models],
             [m.record.std_error(0, 'offset') for m in models])):
        assert 0.5 < np.std(values, ddof=1) / np.mean(errors) < 2.0


def test_a_parameter_at_its_bound_is_marked_and_a_combination_has_its_error():
    truth = candidate('load_simulator')
    light = replace(truth, values={**truth.values, 'J': 1e-12})
    fit = search(light, parts(light, 0.4, 0.01, 1), 1)
    known = replace(fit.identifiability(), at_bound=('J',))
    marked = {name: one.at_bound for name, one in fitted_model(fit, known, {}).parameters.items()}
    assert marked == {name: 'lower' if name == 'J' else '' for name in marked}
    (estimate,) = combination_estimates(fit, known)
    assert known.combinations == {'V_m/beta_e': estimate.std_error / estimate.value}
