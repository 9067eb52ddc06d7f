"""The printed eq. 3 against the tables of the paper."""
import pytest

from hydro_twin.errors import DataError
from hydro_twin.studies.l18.linear_loop import PUBLISHED, Weights
from hydro_twin.studies.l18.printed_equation import parameters_as_printed, printed_weights

TABLE_1 = Weights((7.98e-5, 8.01e-5), (1.96, -0.962, 0.00255))     # [L18]


def test_table_2_gives_table_1() -> None:
    weights = printed_weights(*PUBLISHED, T=0.001)
    assert weights.v == pytest.approx([7.981e-5, 7.981e-5], abs=5e-9)
    assert weights.n == pytest.approx([1.9595, -0.96225, 0.0025539], rel=3e-5)
    assert weights.v == pytest.approx(TABLE_1.v, rel=4e-3)
    assert weights.n == pytest.approx(TABLE_1.n, rel=2e-3)


def test_table_1_gives_table_2_within_its_digits() -> None:
    read = parameters_as_printed(TABLE_1, 0.001, PUBLISHED.k_1)
    assert read == pytest.approx(PUBLISHED, rel=6e-3)


def test_the_mapping_and_back() -> None:
    for loop in (PUBLISHED, PUBLISHED._replace(T_y=0.012, T_c=0.45), PUBLISHED._replace(k_1=0.7)):
        weights = printed_weights(*loop, T=0.002)
        assert parameters_as_printed(weights, 0.002, loop.k_1) == pytest.approx(loop, rel=1e-9)


def test_it_is_dimensionally_wrong() -> None:
    """Time in milliseconds instead of seconds must not change a weight, and here it does."""
    T_y, T_c, tau, k_1 = PUBLISHED
    seconds = printed_weights(T_y, T_c, tau, k_1, 0.001)
    milliseconds = printed_weights(1000 * T_y, 1000 * T_c, 1000 * tau, k_1, 1.0)
    assert milliseconds.n[2] > 100 * seconds.n[2]


def test_weights_of_no_servo_are_refused() -> None:
    with pytest.raises(DataError, match='no real positive'):
        parameters_as_printed(Weights((1e-4, 1e-4), (2.4, -1.9, 0.5)), 0.001, 1.0)
