"""Standard errors of a fit by output error, in the units of the parameters."""
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter
from trace_by_hand import candidate, parts

from hydro_twin.fitting.estimates import combination_estimates, fitted_model
from hydro_twin.fitting.parts import Part
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


def test_a_parameter_at_its_bound_is_marked():
    truth = candidate('load_simulator')
    light = replace(truth, values={**truth.values, 'J': 1e-12})
    fit = search(light, parts(light, 0.4, 0.01, 1), 1)
    known = replace(fit.identifiability(), at_bound=('J',))
    marked = {name: one.at_bound for name, one in fitted_model(fit, known, {}).parameters.items()}
    assert marked == {name: 'lower' if name == 'J' else '' for name in marked}


def test_a_combination_is_known_as_well_as_the_member_that_is_searched():
    truth = candidate('load_simulator')
    rng = np.random.default_rng(0)
    inputs = lfilter([0.1], [1.0, -0.9], rng.standard_normal((1500, 2)) * [2.0, 0.02], axis=0)
    output = truth.system.run(inputs, truth.system.start(inputs[0], 0.0))
    noisy = output + 1e-3 * np.std(output) * rng.standard_normal(1500)
    fit = search(truth, [Part(inputs, noisy)], 10)
    known = fit.identifiability()
    assert known.combinations == {'V_m/beta_e': known.std_error['V_m'],
                                  'K_q*K_sv': known.std_error['K_q']}
    assert known.combinations['K_q*K_sv'] < 0.1
    estimates = combination_estimates(fit, known)
    assert [one.std_error and one.std_error / one.value for one in estimates] == pytest.approx(
        list(known.combinations.values()))
