"""What a residual looks like by itself, on noise whose properties are known."""
import numpy as np
import pytest
from scipy.signal import lfilter

from hydro_twin.fitting.whiteness import is_white
from hydro_twin.inference.noise import (
    bursts,
    BurstSamples,
    lines,
    noise_floor,
)

T = 0.002


def noise(seed, *lengths, memory=0.0):
    rng = np.random.default_rng(seed)
    return [lfilter([np.sqrt(1 - memory**2)], [1, -memory], rng.standard_normal(n + 100))[100:]
            for n in lengths]


@pytest.mark.parametrize('lengths', [(1500,), (700, 300, 1200)])
def test_white_noise_passes_ninety_nine_times_in_a_hundred(lengths):
    passed = sum(is_white(noise(seed, *lengths)) for seed in range(500))
    # Binomial: outside this once in a thousand runs if the level is right.
    assert 0.972 * 500 <= passed <= 0.9995 * 500


@pytest.mark.parametrize('memory', [0.2, -0.2, 0.6])
def test_noise_with_memory_fails(memory):
    assert not any(is_white(noise(seed, 1500, memory=memory)) for seed in range(50))


def test_an_offset_or_another_unit_makes_no_memory():
    r = noise(1, 800, 600)
    assert is_white(r) == is_white([1e-6 * x + 3.0 for x in r])


@pytest.mark.parametrize('memory', [0.0, 0.7])
def test_noise_floor_is_that_of_the_white_part(memory):
    """What the plant leaves is slow; above 165 Hz there is only the sensor."""
    found = []
    for seed in range(40):
        sensor = noise(seed, 950, 950)
        t = T * np.arange(950)
        found.append(noise_floor([2.0 * r + 10 * np.sin(2 * np.pi * 6 * t) for r in sensor]))
    assert np.mean(found) == pytest.approx(2.0, rel=0.03)
    assert np.std(found) < 0.1 * 2.0


@pytest.mark.parametrize('memory', [0.0, 0.8])
@pytest.mark.parametrize('amplitude', [0.5, 2.0])
def test_a_line_is_found_where_it_is(memory, amplitude):
    t = T * np.arange(1000)
    for seed in range(10):
        stretches = [r + amplitude * np.sin(2 * np.pi * 50.2 * t + phase) for r, phase in
                     zip(noise(seed, 1000, 1000, 1000, memory=memory), (0.0, 1.0, 2.5),
                         strict=True)]
        (line,) = lines(stretches, T)
        assert line.frequency == pytest.approx(50.2, abs=0.15)
        assert line.amplitude == pytest.approx(amplitude, rel=0.35)


def test_two_lines_are_two():
    t = T * np.arange(1500)
    (r,) = noise(0, 1500)
    found = lines([r + np.sin(2 * np.pi * 31 * t) + np.sin(2 * np.pi * 120 * t)], T)
    assert [line.frequency for line in found] == pytest.approx([31, 120], abs=0.2)


@pytest.mark.parametrize('memory', [0.0, 0.5, 0.9])
def test_noise_has_no_lines(memory):
    assert not any(lines(noise(seed, 1000, 1000, memory=memory), T) for seed in range(100))


def test_too_short_for_a_line():
    assert lines([np.sin(np.arange(100))], T) == []


@pytest.mark.parametrize(('memory', 'most'), [(0.0, 0), (0.7, 0), (0.97, 8)])
def test_noise_has_no_bursts(memory, most):
    """But that which swings so slowly that these thirty blocks are a few swings, now and then."""
    assert sum(bool(bursts(noise(seed, 900, 600, memory=memory))) for seed in range(500)) <= most


def test_a_burst_is_told_by_when_it_comes():
    first, second = noise(3, 900, 600)
    second[215:260] += 8.0 * np.sin(1.3 * np.arange(45))
    assert bursts([first, second]) == [BurstSamples(1, 200, 300)]


def test_what_comes_again_and_again_is_no_burst():
    """As where a law is lacking that acts at each turn of a motion."""
    r = noise(4, 1500)[0] + 8.0 * (np.arange(1500) % 250 < 50)
    assert bursts([r]) == []
