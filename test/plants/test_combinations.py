"""A product of powers as text, read back by Python itself."""
from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st
import pytest

from hydro_twin.plants.combinations import product_of_powers

EXPONENTS = st.lists(st.sampled_from([-3, -2, -1, 1, 2, 3]), min_size=1, max_size=4)


@given(EXPONENTS)
def test_names_read_back_as_the_product(exponents: list[int]) -> None:
    values = {f'p_{k}': 2.0 + k for k in range(len(exponents))}
    text = product_of_powers(zip(values, exponents, strict=True))
    product = math.prod(v ** e for v, e in zip(values.values(), exponents, strict=True))
    assert eval(text.replace('^', '**'), {}, values) == pytest.approx(product)


def test_a_quotient_keeps_its_parentheses() -> None:
    units = [('m', 1), ('m/V', -1), ('N s', 2)]
    assert product_of_powers(units, ' ', ' / ') == 'm (N s)^2 / (m/V)'
