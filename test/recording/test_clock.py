"""Tests of the clock of a job: what decides it, and how the period of a signal is found."""
from dataclasses import replace

import numpy as np
import pytest

from hydro_twin.errors import UserError
from hydro_twin.plants import PLANTS
from hydro_twin.recording.bag import Samples
from hydro_twin.recording.clock import check_live, Clock, clock_of, period, slowest

FREE = Clock(given=None, usual=0.002, finest=0.002)


def samples(seconds, stamped=True):
    stamps = np.rint(1e9 * np.asarray(seconds)).astype(np.int64)
    return Samples(stamps, np.zeros(len(stamps)), stamped)


@pytest.mark.parametrize('truth', [0.0005, 0.002, 1 / 300, 0.004, 0.05, 0.08, 1.0])
@pytest.mark.parametrize('stamped', [True, False])
def test_a_period_is_told_through_jitter_and_losses(truth, stamped):
    rng = np.random.default_rng(0)
    late = 0.03 * truth * np.abs(rng.standard_normal(500))
    late[200:205] = truth * np.array([4.0, 3.1, 2.2, 1.3, 0.4])     # a stall, then a burst
    kept = np.sort(rng.choice(500, 460, replace=False))
    found = period(samples((100.0 + truth * np.arange(500) + late)[kept], stamped))
    assert found == pytest.approx(truth, rel=2e-3)


def test_messages_that_arrive_in_bursts_show_their_period():
    k = np.arange(400)
    received = 0.05 * (k // 3 * 3 + 2) + 1e-3 * (k % 3)
    assert period(samples(received, stamped=False)) == pytest.approx(0.05, rel=0.02)


@pytest.mark.parametrize(('truth', 'expected'), [
    (0.05, 0.05), (0.0500049, 0.05), (0.0510204, 0.0510204), (1 / 300, 0.003333333)])
def test_a_period_is_a_round_number_where_it_nearly_is_one(truth, expected):
    assert period(samples(truth * np.arange(2000))) == pytest.approx(expected, rel=1e-6)
    if expected == 0.05:
        assert period(samples(truth * np.arange(2000))) == expected


def test_a_few_samples_have_a_period_and_one_has_none():
    assert FREE.over([period(samples([5.0]))]) == 0.002
    assert period(samples([5.0, 6.0])) == 1.0
    assert period(samples([5.0, 6.0, 106.0])) == 100.0


@pytest.mark.parametrize(('periods', 'expected'), [
    ([0.0005], 0.002), ([0.001], 0.002), ([0.0019], 0.002), ([0.00215], 0.002),
    ([0.0025], 0.0025), ([0.05], 0.05), ([0.002, 0.01, 0.004], 0.01)])
def test_the_slowest_measurement_decides_but_none_finer_than_is_worth_it(periods, expected):
    assert FREE.over(periods) == expected


def test_the_configuration_decides_over_all():
    assert replace(FREE, given=0.001).over([0.05]) == 0.001
    assert replace(FREE, given=0.001).unrecorded == 0.001
    assert FREE.unrecorded == 0.002


def test_commands_set_no_clock_and_measured_inputs_do():
    bag = {'u_m': samples(0.5 * np.arange(20)), 'theta_d': samples(0.01 * np.arange(900)),
           'T_g': samples(0.002 * np.arange(4500))}
    assert slowest(bag, {'u_m'}) == 0.01


@pytest.mark.parametrize(('plant', 'recorded', 'expected'), [
    ('cylinder', 0.05, 0.05), ('cylinder', 0.002, 0.002), ('cylinder', 0.001, 0.002),
    ('positioning', 0.001, 0.001), ('control_valve', 0.08, 0.08), ('control_valve', 1.0, 1.0),
    ('control_valve', 0.95, 1.0), ('control_valve', 0.002, 0.02), ('load_simulator', 0.004, 0.004),
])
def test_every_plant_is_worked_at_what_its_recording_bears(plant, recorded, expected):
    assert clock_of(PLANTS[plant], {}, '').over([recorded]) == expected


def test_a_model_brings_its_clock():
    clock = clock_of(PLANTS['cylinder'], {}, '', model=0.05)
    assert [clock.over([period]) for period in (0.002, 0.046, 0.054, 0.1)] == [
        0.05, 0.05, 0.05, 0.1]


def test_the_default_of_the_node_leaves_the_clock_to_the_recording():
    assert (clock_of(PLANTS['cylinder'], {'sample_time': 0.0}, 'dumped.yaml')
            == clock_of(PLANTS['cylinder'], {}, ''))


@pytest.mark.parametrize('value', [-0.1, 'fast', True])
def test_a_sample_time_is_a_number_not_below_zero(value):
    with pytest.raises(UserError, match=r'rig\.yaml: sample_time must'):
        clock_of(PLANTS['cylinder'], {'sample_time': value}, 'rig.yaml')


def test_the_node_takes_no_clock_but_that_of_its_model():
    for given in (None, 0.002, 0.0020000000001):
        check_live(given, 0.002)
    with pytest.raises(UserError, match=r'sample_time is 0\.004 s, but the model runs at 0\.002'):
        check_live(0.004, 0.002)
    with pytest.raises(UserError, match='sample_time must be a finite number'):
        check_live('fast', 0.002)
