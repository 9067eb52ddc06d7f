"""Is the challenger better? A test by betting that stays valid however often one looks.

In every block of samples the two models have mean squared residuals a (champion) and b
(challenger). The relative gain x = (a - b) / (a + b) lies between -1 and 1, whatever the residual
does. The null hypothesis is that its mean, given the past, is not above a least gain m. Whoever
bets the share l of a capital on x > m in each block multiplies it by 1 + l (x - m) / (1 + m).
Under the null no bet has an expected gain, so by Ville's inequality the capital, 1 at the start,
ever reaches 1 / alpha with a probability of at most alpha: the e-process of Waudby-Smith and
Ramdas (Estimating means of bounded random variables by betting, J. R. Stat. Soc. B 86, 2024). The
capital is spread over a grid of shares, so that none has to be chosen: an average of such capitals
is one, too.
"""
from __future__ import annotations

from dataclasses import dataclass, field
import math

SHARES = (*(0.02 * 1.25 ** k for k in range(18)), 0.95)   # 0.02 to 0.89, and 0.95


@dataclass
class Bet:
    """The capital of one side, in logarithms, for a share each.

    Attributes:
        least: the mean gain that must be exceeded, m, above -1 and below 1.
        blocks: how many were bet on.
    """

    least: float = 0.0
    blocks: int = 0
    _logs: list[float] = field(default_factory=lambda: [0.0] * len(SHARES))

    def take(self, gain: float) -> float:
        """Bet on one block.

        Args:
            gain: (a - b) / (a + b), from -1 to 1.

        Returns:
            The log of the capital.

        Raises:
            ValueError: the gain is not in that range.
        """
        if not -1.0 <= gain <= 1.0:
            raise ValueError(f'gain {gain}: from -1 to 1 is possible')
        won = (gain - self.least) / (1.0 + self.least)     # never below -1
        self.blocks += 1
        self._logs = [log + math.log1p(share * won)
                      for log, share in zip(self._logs, SHARES, strict=True)]
        return self.log_capital

    @property
    def log_capital(self) -> float:
        """The log of the capital: the evidence against the null hypothesis."""
        top = max(self._logs)
        return top + math.log(sum(math.exp(log - top) for log in self._logs) / len(SHARES))

    @property
    def e_value(self) -> float:
        """The capital, at most 1e300."""
        return math.exp(min(self.log_capital, 690.0))


def relative_gain(a: float, b: float) -> float:
    """Return (a - b) / (a + b) of two mean squares; 0 where both are 0, inf counts as lost."""
    if math.isinf(a) or math.isinf(b):
        return float(math.isinf(a)) - float(math.isinf(b))
    return (a - b) / (a + b) if a + b > 0.0 else 0.0


def least_gain(share: float) -> float:
    """Turn a least reduction of the mean square, as a share, into one of the relative gain."""
    return share / (2.0 - share)
