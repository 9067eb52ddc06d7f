"""The error of the time steps is distinguished from what a law may still explain."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from trace_by_hand import candidate, parts

from hydro_twin.inference.search import LONG, search
from hydro_twin.inference.stepwise import (
    is_discretisation_error,
    step_halving_change,
    with_fine_steps,
)

FRICTION = ('friction', 'motor', {'coulomb': 10.0})


@pytest.mark.parametrize(('name', 'law'), [
    ('load_simulator', FRICTION), ('positioning', FRICTION)])
def test_without_noise_what_is_left_is_the_error_of_the_time_steps(name, law):
    truth = candidate(name, [law])
    made = parts(replace(truth, substeps=64), 1.2, 0.0, 2)
    fit = search(replace(truth, substeps=2), made, LONG)
    assert is_discretisation_error(fit, made)
    noisy = [replace(part, measured=part.measured + 30.0 * step_halving_change(fit.candidate, made)
                     * np.random.default_rng(k).standard_normal(len(part.measured)))
             for k, part in enumerate(made)]
    assert not is_discretisation_error(search(fit.candidate, noisy, LONG), noisy)


def test_a_linear_model_has_no_error_of_the_time_steps_where_commands_act_at_the_samples():
    made = parts(candidate('load_simulator', [FRICTION]), 1.2, 0.0, 2)
    fit = search(candidate('load_simulator', []), made, LONG)
    on_time, within = (replace(fit.candidate, timing={'u_m': -early * fit.candidate.sample_time})
                       for early in (1.0, 0.6))
    assert step_halving_change(on_time, made) < 1e-9 * fit.error
    assert step_halving_change(within, made) > 1e-9 * fit.error
    assert with_fine_steps(fit, made, 16).candidate.substeps == fit.candidate.substeps
