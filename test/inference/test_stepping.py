"""The error of the time steps is distinguished from what a law may still explain."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from trace_by_hand import candidate, parts

from hydro_twin.inference.chain import finely, halving, is_stepping
from hydro_twin.inference.select import LONG, search

FRICTION = ('friction', 'motor', {'coulomb': 10.0})


@pytest.mark.parametrize(('name', 'law'), [
    ('load_simulator', FRICTION), ('positioning', FRICTION)])
def test_without_noise_what_is_left_is_the_error_of_the_time_steps(name, law):
    truth = candidate(name, [law])
    made = parts(replace(truth, substeps=64), 1.2, 0.0, 2)
    fit = search(replace(truth, substeps=2), made, LONG)
    assert is_stepping(fit, made)
    noisy = [replace(part, measured=part.measured + 30.0 * halving(fit.candidate, made)
                     * np.random.default_rng(k).standard_normal(len(part.measured)))
             for k, part in enumerate(made)]
    assert not is_stepping(search(fit.candidate, noisy, LONG), noisy)


def test_a_linear_model_has_no_error_of_the_time_steps():
    made = parts(candidate('load_simulator', [FRICTION]), 1.2, 0.0, 2)
    fit = search(candidate('load_simulator', []), made, LONG)
    assert halving(fit.candidate, made) < 1e-9 * fit.error
    assert finely(fit, made, 16).candidate.substeps == fit.candidate.substeps
