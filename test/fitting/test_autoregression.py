"""Coloured noise as an autoregressive process, on noise whose process is known."""
from coloured_noise import coloured
import numpy as np
import pytest
from scipy.signal import lfilter

from hydro_twin.fitting.autoregression import (
    autoregression,
    effective_samples,
    noise_filter,
    whiten,
)
from hydro_twin.fitting.whiteness import is_white


def test_autoregression_is_the_process():
    rng = np.random.default_rng(0)
    r = lfilter([1.0], [1.0, -1.2, 0.6], rng.standard_normal(50_000))
    found = autoregression([r[:20_000], r[20_000:]], order=3)
    np.testing.assert_allclose(found, [1.0, -1.2, 0.6, 0.0], atol=0.02)


def test_whitened_noise_is_white():
    passed = 0
    for seed in range(100):
        r = [coloured(seed, 900, 0.8), coloured(1000 + seed, 900, 0.8)]
        white = whiten(r, autoregression(r))
        assert len(white) == 2 * (900 - 6)
        passed += is_white([white])
    assert passed >= 97


def test_pieces_shorter_than_the_filter_count_as_if_zeros_followed_them():
    rng = np.random.default_rng(0)
    pieces = [rng.standard_normal(n) for n in (1, 2, 3, 4, 5, 6, 7, 40)]
    padded = [np.append(r, np.zeros(6)) for r in pieces]
    np.testing.assert_allclose(autoregression(pieces), autoregression(padded))


def test_the_filter_of_short_pieces_is_finite():
    rng = np.random.default_rng(0)
    assert np.isfinite(noise_filter([rng.standard_normal(3) for _ in range(30)])).all()


def test_silence_has_no_memory():
    np.testing.assert_array_equal(autoregression([np.zeros(100)]), [1, 0, 0, 0, 0, 0, 0])


def test_the_filter_of_noise_keeps_its_power():
    r = coloured(0, 20_000, 0.9)
    white = whiten([r], noise_filter([r]))
    assert is_white([white])
    assert white @ white / len(white) == pytest.approx(r @ r / len(r), rel=1e-9)


@pytest.mark.parametrize('memory', [0.0, 0.5, 0.9, 0.98])
def test_samples_with_memory_count_as_fewer(memory):
    counts = [effective_samples([coloured(seed, 6000, memory), coloured(100 + seed, 2000, memory)])
              for seed in range(20)]
    expected = 8000 * (1.0 - memory**2) / (1.0 + memory**2)     # sum of the squares of memory^|k|
    assert np.mean(counts) == pytest.approx(expected, rel=0.15)


def test_silence_counts_in_full():
    assert effective_samples([np.zeros(100), np.zeros(50)]) == 150.0
