"""A tandem-compound turbine with reheat: power from steam flow.

Three lags in series, each giving a fraction of the power. Structure: IEEE Committee Report,
Dynamic models for steam and hydro turbines in power system studies, IEEE Trans. Power Apparatus
and Systems 92 (1973) 1904-1915. Values: those that IEC 61970-302 gives as typical for it
(GovSteamIEEE1: T4, T5, T6, K1, K3, K5).
"""
from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.signal import cont2discrete

from hydro_twin.plants.plant import Constant

CONSTANTS = (
    Constant('T_CH', 'time constant of inlet piping and steam chest', 's', 0.3),
    Constant('T_RH', 'time constant of the reheater', 's', 5.0),
    Constant('T_CO', 'time constant of the crossover piping', 's', 0.5),
    Constant('F_HP', 'share of the high pressure part in the power', '1', 0.2),
    Constant('F_IP', 'share of the intermediate pressure part', '1', 0.3),
    Constant('F_LP', 'share of the low pressure part', '1', 0.5),
)


class Turbine:
    """The turbine, sample by sample, flow and power in units of nominal."""

    def __init__(self, values: Mapping[str, float], sample_time: float, flow: float) -> None:
        """Start at rest.

        Args:
            values: of `CONSTANTS`, by name.
            sample_time: time of a step [s].
            flow: steam flow at rest [1].
        """
        T_CH, T_RH, T_CO = values['T_CH'], values['T_RH'], values['T_CO']
        A = np.array([[-1 / T_CH, 0, 0], [1 / T_RH, -1 / T_RH, 0], [0, 1 / T_CO, -1 / T_CO]])
        B = np.array([[1 / T_CH], [0], [0]])
        self.shares = np.array([values['F_HP'], values['F_IP'], values['F_LP']])
        self.F, H, *_ = cont2discrete((A, B, self.shares[None], np.zeros((1, 1))), sample_time)
        self.H = H[:, 0]
        self.x = np.full(3, flow)

    @property
    def power(self) -> float:
        """Power now [1]."""
        return float(self.shares @ self.x)

    def step(self, flow: float) -> None:
        """Go on by one sample with this steam flow [1]."""
        self.x = self.F @ self.x + self.H * flow
