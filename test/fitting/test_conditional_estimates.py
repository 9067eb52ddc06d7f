"""For which of the plant's parameters the size of an effect is stated."""
from dataclasses import replace

import numpy as np
import pytest
from trace_by_hand import candidate

from hydro_twin.fitting.conditional_estimates import conditional_on
from hydro_twin.fitting.parts import Part
from hydro_twin.inference.search import search
from hydro_twin.model import place

TIME = 0.002 * np.arange(1500)
INPUTS = {
    'load_simulator': np.column_stack([0.3 * np.sin(9.0 * TIME) + 0.2 * np.sin(31.0 * TIME),
                                       0.05 * np.sin(4.0 * TIME)]),
    'valve_servo': 0.5 + 0.2 * np.sin(5.5 * TIME)[:, None] + 0.1 * np.sin(16.5 * TIME)[:, None]}
DEAD_ZONE = ('dead_zone', 'spool', {'width': 1e-6})
LIMIT = ('saturation', 'spool', {'lower': -1e-5, 'upper': 1e-5})
HYSTERESIS = ('hysteresis', 'pilot', {'width': 0.01})


def run(model, inputs):
    return model.system.run(inputs, model.system.start(inputs[0], 0.5))


@pytest.mark.parametrize(('plant', 'effects', 'expected'), [
    ('load_simulator', [DEAD_ZONE], {'0:width': ('K_sv',)}),
    ('load_simulator', [DEAD_ZONE, LIMIT],
     {'0:width': ('K_sv',), '1:lower': ('K_sv',), '1:upper': ('K_sv',)}),
    ('load_simulator', [('dead_zone', 'command', {'width': 0.05})], {}),
    ('load_simulator', [('friction', 'motor', {'coulomb': 5.0})], {}),
    ('valve_servo', [HYSTERESIS], {'0:width': ('k_1',)}),
    ('valve_servo', [('rate_limit', 'actuator', {'limit': 0.3})], {})])
def test_an_effect_inside_a_combination_is_known_for_a_member_of_it(plant, effects, expected):
    truth, inputs = candidate(plant, effects), INPUTS[plant]
    output = run(truth, inputs)
    noise = 1e-4 * output.std() * np.random.default_rng(0).standard_normal(len(output))
    part = Part(inputs, output + noise)
    assert conditional_on(search(truth, [part], 10), [part]) == expected


@pytest.mark.parametrize(('plant', 'effect', 'twice', 'half'), [
    ('load_simulator', DEAD_ZONE, ['K_sv'], ['K_q']),
    ('valve_servo', HYSTERESIS, ['k_1', 'T_c'], [])])
def test_twice_the_member_and_twice_the_effect_are_the_same(plant, effect, twice, half):
    model = candidate(plant, [effect])
    factors = dict.fromkeys(twice, 2.0) | dict.fromkeys(half, 0.5)
    identifier, port, values = effect
    other = replace(
        model, values={name: factors.get(name, 1.0) * v for name, v in model.values.items()},
        effects=(place(identifier, port, {'width': 2.0 * values['width']}, model.plant),))
    inputs = INPUTS[plant]
    assert run(other, inputs) == pytest.approx(run(model, inputs), rel=1e-9, abs=1e-9)
