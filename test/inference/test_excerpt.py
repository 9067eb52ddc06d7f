"""Long recordings are cut to stretches, spread evenly, and thinned where that does no harm."""
import numpy as np
import pytest

from hydro_twin.fitting.linear import fit_linear
from hydro_twin.fitting.parts import least_samples, Part, parts_of, thin
from hydro_twin.inference.excerpt import (
    COARSEST,
    decimation_factor,
    excerpt,
    MAX_SAMPLES,
    resampled,
    STRETCH_SAMPLES,
)
from hydro_twin.inference.search import LONG, search
from hydro_twin.model import Model, place
from hydro_twin.plants import plant_named
from hydro_twin.recording.series import Recording, Series

PLANT = plant_named('load_simulator')
DT = PLANT.sample_time
START = PLANT.start_samples(DT)


def part(n, source):
    return Part(np.arange(n, dtype=float)[:, None], np.arange(n, dtype=float), source)


def test_what_is_short_is_kept_whole():
    parts = [part(1000, 'a'), part(3000, 'b')]
    assert excerpt(parts, PLANT, DT) == parts


def test_stretches_are_long_enough_to_be_scored_at_any_rate():
    fast = 5e-5                 # a start-up of more samples than a stretch usually has
    assert PLANT.start_samples(fast) > STRETCH_SAMPLES
    cut = excerpt([part(60_000, 'a')], PLANT, fast)
    assert cut
    assert all(len(one.measured) >= least_samples(PLANT, fast) for one in cut)


def test_what_can_be_thinned_enough_is_kept_whole():
    whole = [part(30_000, 'a')]
    assert excerpt(whole, PLANT, DT, 4) == whole
    cut = excerpt(whole, plant_named('cylinder'), DT, 4)
    assert [len(p.measured) for p in cut] == [STRETCH_SAMPLES] * 20
    np.testing.assert_array_equal(np.concatenate([p.measured for p in cut]), np.arange(30_000))


def test_a_plant_that_integrates_is_cut_into_windows():
    plant, sample_time = plant_named('cylinder'), 0.05
    cut = excerpt([part(1000, 'a'), part(250, 'b'), part(90, 'c')], plant, sample_time)
    assert [len(p.measured) for p in cut] == [200] * 5 + [125] * 2 + [90]
    np.testing.assert_array_equal(np.concatenate([p.measured for p in cut[:5]]), np.arange(1000))
    whole = [part(1000, 'a')]
    assert excerpt(whole, plant_named('control_valve'), 1.0) == whole


@pytest.mark.parametrize('lengths', [(1_800_000,), (100_000, 100_000), (7_000, 3_000, 500),
                                     (600,) * 400])
def test_enough_is_kept_from_begin_to_end(lengths):
    parts = [part(n, str(k)) for k, n in enumerate(lengths)]
    cut = excerpt(parts, PLANT, DT)
    scored = sum(len(p.measured) - START for p in cut)
    assert 0.4 * MAX_SAMPLES <= scored <= 3 * MAX_SAMPLES
    for one in cut:
        np.testing.assert_array_equal(one.inputs[:, 0], one.measured)   # cut alike
        assert (np.diff(one.measured) == 1).all()
    firsts = [(int(one.source), one.measured[0]) for one in cut]
    assert firsts == sorted(firsts)
    assert int(cut[-1].source) >= 0.9 * (len(lengths) - 1)
    if len(lengths) == 1:       # one in each share of the recording
        shares = [int(first * len(cut) / lengths[0]) for _, first in firsts]
        assert shares == list(range(len(cut)))


@pytest.mark.parametrize('factor', [2, 8])
def test_what_will_be_thinned_may_be_more_and_does_not_overlap(factor):
    cut = excerpt([part(100_000, '0')], PLANT, DT, factor)
    scored = sum(len(p.measured) // factor - PLANT.start_samples(factor * DT) for p in cut)
    assert 1.5 * MAX_SAMPLES / factor < scored <= 1.1 * MAX_SAMPLES
    assert all(len(p.measured) == STRETCH_SAMPLES for p in cut)
    starts = np.array([p.measured[0] for p in cut])
    assert (np.diff(starts) >= STRETCH_SAMPLES).all()
    assert len(np.unique(np.diff(starts))) > 1              # in step with nothing


def test_thinned_commands_keep_their_mean_and_the_rest_its_values():
    plant = plant_named('load_simulator')
    inputs = np.random.default_rng(0).standard_normal((1001, 2))
    thinned, = thin([Part(inputs, np.arange(1001.0))], plant, 4)
    assert thinned.inputs[:, 0].mean() == pytest.approx(inputs[:1000, 0].mean())
    assert thinned.inputs[3, 0] == pytest.approx(inputs[12:16, 0].mean())
    np.testing.assert_array_equal(thinned.inputs[:, 1], inputs[:1000:4, 1])
    np.testing.assert_array_equal(thinned.measured, np.arange(0.0, 1000.0, 4.0))


def recorded(name, values, frequency, seconds, *effects):
    """Run a plant under two sinusoids; with the linear fit to an excerpt."""
    plant = plant_named(name)
    time = plant.sample_time * np.arange(round(seconds / plant.sample_time))
    inputs = np.zeros((len(time), len(plant.inputs)))
    inputs[:, 0] = 100.0 * sum(np.sin(2 * np.pi * frequency * f * time) for f in (1.0, 2.7))
    rig = Model(plant, {**plant.constant_values(), **values}, plant.sample_time,
                tuple(place(*effect, plant) for effect in effects), substeps=2)
    output = rig.system.run(inputs, rig.system.start(inputs[0], 0.0))
    columns = {s.name: u for s, u in zip(plant.inputs, inputs.T, strict=True)}
    series = Series({**columns, plant.output.name: output}, plant.sample_time, 0)
    parts = excerpt(parts_of(Recording([series]), plant), plant, plant.sample_time)
    fit = fit_linear(plant, parts, plant.constant_values(), plant.sample_time)
    return rig, parts, search(fit.candidate, parts, LONG), len(time)


def test_a_slow_plant_is_thinned_and_a_fast_one_is_not():
    _, parts, fit, samples = recorded('positioning', {'M': 100.0, 'F_v': 200.0}, 0.3, 30.0,
                                      ('friction', 'motor', {'coulomb': 20.0}))
    assert decimation_factor(fit, parts, samples) > 1
    assert decimation_factor(fit, parts, MAX_SAMPLES) == 1         # short enough as it is
    _, parts, fit, samples = recorded('positioning', {'M': 2.0, 'F_v': 2000.0}, 60.0, 30.0,
                                      ('friction', 'motor', {'coulomb': 20.0}))
    assert decimation_factor(fit, parts, samples) == 1


def test_a_thinned_run_is_the_run_thinned():
    rig, parts, _, _ = recorded('positioning', {'M': 100.0, 'F_v': 200.0}, 0.3, 30.0,
                                ('friction', 'motor', {'coulomb': 20.0}))
    coarse = resampled(rig, COARSEST * rig.sample_time)
    whole, few = parts[0], thin(parts[:1], rig.plant, COARSEST)[0]
    start = rig.system.start(whole.inputs[0], 0.0)
    run = coarse.system.run(few.inputs, start)
    expected = rig.system.run(whole.inputs, start)[::COARSEST][:len(run)]
    assert np.abs(run - expected).max() < 0.01 * np.ptp(expected)
    assert resampled(coarse, rig.sample_time).sample_time == rig.sample_time


def test_parts_that_would_be_too_short_once_they_are_thinned_are_left_out():
    short = part(8 * least_samples(PLANT, 8 * DT) - 1, 'short')
    cut = excerpt([part(30_000, 'long'), short], PLANT, DT, 8)
    assert {one.source for one in cut} == {'long'}
    assert excerpt([short], PLANT, DT, 8) == []
