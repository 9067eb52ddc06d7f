"""The power controller of primary frequency control: speed droop, then PID to a valve command."""
from __future__ import annotations

from collections.abc import Mapping

from hydro_twin.plants.plant import Constant

CONSTANTS = (   # droop and dead band as usual for large units (GB/T 30370-2013)
    Constant('f_n', 'nominal frequency', 'Hz', 50.0),
    Constant('droop', 'speed droop: deviation, as a share of f_n, for 100 % of nominal power', '1',
             0.05),
    Constant('dead_band', 'deviations up to this, either way, cause no response', 'Hz', 0.033),
    # As usual for units of 500 MW and more, of their nominal power (GB/T 30370-2013).
    Constant('amplitude', 'limit of the power that frequency asks for, of nominal', '1', 0.06),
    Constant('K_P', 'proportional gain, opening by power', '1', 0.5),
    Constant('K_I', 'integral gain', '1/s', 0.2),
    Constant('K_D', 'derivative gain', 's', 0.1),
    Constant('T_D', "time constant of the derivative's filter", 's', 0.5),
    Constant('u_max', 'largest command', '1', 1.1),
)


def power_asked(frequency: float, load: float, values: Mapping[str, float]) -> float:
    """Compute the power that droop asks for, within the amplitude limit [1].

    Args:
        frequency: of the grid [Hz].
        load: power asked for at nominal frequency [1].
        values: of `CONSTANTS`, by name.
    """
    deviation = frequency - values['f_n']
    beyond = max(abs(deviation) - values['dead_band'], 0.0)
    sign = 1.0 if deviation > 0 else -1.0
    asked = min(beyond / (values['droop'] * values['f_n']), values['amplitude'])
    return load - sign * asked


class PowerControl:
    """The PID, sample by sample; at a limit of the command its integral stands still."""

    def __init__(self, values: Mapping[str, float], sample_time: float, command: float,
                 power: float) -> None:
        """Start at rest, with this command [1] giving this power [1]."""
        self.values = values
        self.sample_time = sample_time
        self.integral = command
        self.slow_power = power

    def step(self, asked: float, power: float) -> float:
        """Return the command [1] for the power asked for and the power there is [1]."""
        v = self.values
        error = asked - power
        # The derivative acts on the power only, so that a jump of the load makes no kick.
        rate = (power - self.slow_power) / v['T_D']
        self.slow_power += self.sample_time * rate
        rise = self.sample_time * v['K_I'] * error
        command = self.integral + rise + v['K_P'] * error - v['K_D'] * rate
        if 0.0 < command < v['u_max']:
            self.integral += rise
        return min(max(command, 0.0), v['u_max'])
