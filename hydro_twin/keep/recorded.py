"""Two models side by side on recordings: which regimes these show, and how the newer does there.

The samples, the twins and the bets are those of a trial. A recording may be of the rig as it was.
So it can show that the newer model holds in a regime, but not that it is worse on the rig of now.
"""
from __future__ import annotations

from hydro_twin.errors import ModelError
from hydro_twin.keep.duel import Duel, in_one_mode, Rules
from hydro_twin.keep.regime_bets import Regimes
from hydro_twin.keep.regimes import grid_of, Known, seen
from hydro_twin.live.models import check_same_inputs
from hydro_twin.live.twin import Twin
from hydro_twin.recording.clock import same
from hydro_twin.recording.series import Recording


def compare(champion: Twin, challenger: Twin, fitted: Recording, earlier: Recording,
            ) -> tuple[Known, Regimes]:
    """Compare two models on recordings, regime by regime.

    Args:
        champion: the older one.
        challenger: the newer one.
        fitted: recordings that the challenger was made from; they only show regimes.
        earlier: other recordings, on which the two are compared.

    Returns:
        What is known of the regimes, and the evidence that it is from.

    Raises:
        ModelError: the models are not of one plant and of the clock of the recordings, or no
            recording is long enough.
    """
    check_same_inputs(challenger, champion)
    champion, challenger = in_one_mode(champion, challenger)
    plant, sample_time = champion.predictor.plant, champion.predictor.sample_time
    every = fitted + earlier
    if not same(every.sample_time, sample_time):
        raise ModelError(f'the recordings are read at {every.sample_time:g} s, the models run at '
                         f'{sample_time:g} s')
    grid = grid_of(every, plant)
    regimes = Regimes(grid, plant, sample_time, Rules().gain)
    duel = Duel(champion, challenger, Rules(), regimes)
    for series in earlier.series:
        duel.restart()
        inputs = series.stacked([signal.name for signal in plant.inputs])
        sensors = series.stacked([sensor.name for sensor in plant.sensors])
        for stamp, row, output, beside in zip(series.stamps.tolist(), inputs,
                                              series[plant.output.name].tolist(), sensors,
                                              strict=True):
            duel.step(stamp, row, output, beside)
    return Known(challenger.mode, grid, seen(every, plant, grid), {
        name: one.holds.e_value for name, one in regimes.found.items()}), regimes
