"""Parameters that act only together, as a product of powers."""
from __future__ import annotations

from collections.abc import Iterable


def product_of_powers(factors: Iterable[tuple[str, int]], times: str = '*', over: str = '/'
                      ) -> str:
    """Write a product of powers: V_m and beta_e with 1 and -1 are V_m/beta_e.

    Args:
        factors: names or units with their exponents, none of them 0.
        times: what stands between factors.
        over: what stands before a divisor.
    """
    factors = list(factors)
    above = [base if exponent == 1 else f'{_grouped(base)}^{exponent}'
             for base, exponent in factors if exponent > 0]
    below = [_grouped(base) if exponent == -1 else f'{_grouped(base)}^{-exponent}'
             for base, exponent in factors if exponent < 0]
    return over.join([times.join(above) or '1', *below])


def _grouped(base: str) -> str:
    """Put a unit that is itself a product or a quotient in parentheses."""
    return f'({base})' if ' ' in base or '/' in base or '^' in base else base
