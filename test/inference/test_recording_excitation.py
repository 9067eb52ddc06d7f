"""Whether a recording is worth a trace, and which motion would make it so."""
from __future__ import annotations

from dataclasses import replace
import json
import re

import numpy as np
import pytest
from scipy.signal import freqresp
from traced_rig import PLANT, record, VALUES

from hydro_twin.commands.main import main
from hydro_twin.fitting.parts import parts_of
from hydro_twin.inference.excitation import excitation
from hydro_twin.inference.search import search
from hydro_twin.model import Model, Record, Uncertainty, write_model
from hydro_twin.plants import plant_named
from hydro_twin.recording.series import Recording, Series
from hydro_twin.recording.signals import load_signals
from hydro_twin.recording.write import write_recording
from hydro_twin.simulation.simulate import simulate

MODEL = Model(PLANT, VALUES, 0.002, record=Record(
    {p.name: Uncertainty(std_error=0.01 * VALUES[p.name]) for p in PLANT.parameters}))
TIME = 0.002 * np.arange(1500)


@pytest.fixture(scope='module')
def rich():
    return record(count=3, duration=4.0)


def run(u_m=0.0 * TIME, theta_d=0.0 * TIME, start=0) -> Series:
    """Run the model, and add noise."""
    inputs = np.column_stack([u_m, theta_d])
    torque = MODEL.system.run(inputs, np.zeros(len(PLANT.states)))
    torque = torque + 0.5 * np.random.default_rng(start).standard_normal(len(TIME))
    return Series({'u_m': u_m, 'theta_d': theta_d, 'T_g': torque}, 0.002, start)


def test_standard_errors_are_those_that_a_fit_has(rich):
    found = excitation(rich, MODEL)
    assert found.enough
    fit = search(MODEL, parts_of(rich, PLANT), 10).identifiability()
    for name in ('V_m', 'K_p', 'K_q', 'G', 'K_ce'):
        assert found.std_errors[name] == pytest.approx(fit.std_error[name], rel=0.3)


def test_what_is_to_be_traced_does_not_count_as_noise(rich):
    rubbing = excitation(record(('friction', 'motor', {'coulomb': 6.0}), count=3, duration=4.0),
                         MODEL)
    for name, error in excitation(rich, MODEL).std_errors.items():
        assert rubbing.std_errors[name] == pytest.approx(error, rel=0.3)


def test_at_rest_it_says_what_to_move():
    found = excitation(record(count=2, amplitude=0.0), MODEL)
    assert not found.enough
    assert {weak.name for weak in found.weak} == set(found.std_errors)
    assert len(found.undetectable) > 0.5 * found.tried
    assert re.search(r'at most 25% is needed\)?: excite theta_d near', found.says)
    still = Recording((Series({name: np.zeros(1500) for name in ('u_m', 'theta_d', 'T_g')},
                              0.002),))
    assert excitation(still, MODEL).says == 'T_g never moves in the recording'
    assert not excitation(still, MODEL).enough


def test_a_motion_is_no_faster_than_a_slow_recording_shows():
    valve = plant_named('control_valve')
    values = {p.name: float(np.sqrt(p.lower * p.upper)) for p in valve.parameters}
    u = 0.005 * np.sin(2 * np.pi * 0.01 * np.arange(300.0))
    one = simulate(valve, values, [], {'command': lambda t: np.interp(t, np.arange(300.0), u)},
                   300.0, sample_time=1.0)
    noisy = one['opening'] + 0.02 * np.random.default_rng(0).standard_normal(len(one))
    one = replace(one, columns={**one.columns, 'opening': noisy})
    found = excitation(Recording((one,)), Model(valve, values, 1.0, record=Record(
        {name: Uncertainty(std_error=0.01 * value) for name, value in values.items()})))
    weak = {one.name: one for one in found.weak}
    # A first-order lag shows its time constant most where its gain has fallen to 0.7.
    assert weak['tau'].hertz == pytest.approx(1.0 / (2.0 * np.pi * values['tau']), rel=0.3)


def test_the_motion_that_it_names_shows_what_it_promises():
    """Recorded beside the recording, with the output as large; its gain is by scipy."""
    one = run(u_m=sum(0.1 * np.sin(2 * np.pi * f * TIME) for f in (0.7, 3.1, 13.0)))
    weak = {weak.name: weak for weak in excitation(Recording((one,)), MODEL).weak}
    assert weak['K_ce'].std_error is None
    assert weak['K_ce'].signal == 'theta_d'
    laws = PLANT.laws(MODEL.values)
    _, gain = freqresp((laws.A, laws.B[:, 1:], laws.C, laws.D[:, 1:]),
                       2 * np.pi * np.geomspace(0.1, 50.0, 80))
    amplitude = np.sqrt(2.0) * np.std(one['T_g']) / np.abs(gain).max()
    sine = run(theta_d=amplitude * np.sin(2 * np.pi * weak['K_ce'].hertz * TIME),
               start=10_000_000_000)
    both = excitation(Recording((one, sine)), MODEL)
    assert both.std_errors['K_ce'] == pytest.approx(weak['K_ce'].with_it, rel=0.3)
    assert weak['K_ce'].with_it < weak['K_ce'].needed


def test_the_verb(tmp_path, capsys, rich):
    model, bag = tmp_path / 'model.yaml', tmp_path / 'bag'
    write_model(MODEL, model)
    write_recording(bag, rich.series,
                    load_signals(PLANT.name, [signal.name for signal in PLANT.signals]))
    assert main(['excitation', str(bag), '--model', str(model), '--json']) == 0
    result = json.loads(capsys.readouterr().out)
    assert result['enough']
    assert result['says'].startswith('7 of 7 parameters')
    assert main(['excitation', str(bag), '--model', str(model)]) == 0
    assert 'enough for a trace' in capsys.readouterr().out
