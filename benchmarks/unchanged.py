"""Count what `keep` promotes in ten hours of a rig that does not change.

    python benchmarks/unchanged.py [--hours 10]

Every half hour a challenger comes from a trace of another minute of the same rig, as after a false
alarm, and is judged for all of that half hour. Faster than real time and exact: the motion is
periodic, so the free runs of both models are computed once, over a period, and each sample gets
noise of its own; the duel and its bets are those of `keep`. With white noise, and with noise that
has a memory of 0.2 s.
"""
from __future__ import annotations

import argparse
import json
import math

import numpy as np
from scipy.signal import lfilter

from hydro_twin.fitting.output_error import free_run
from hydro_twin.fitting.parts import Part, parts_of
from hydro_twin.inference.excerpt import excerpt
from hydro_twin.inference.search import search
from hydro_twin.keep.duel import Duel, Rules
from hydro_twin.keep.regime_bets import Regimes
from hydro_twin.keep.regimes import grid_of
from hydro_twin.live.twin import Twin
from hydro_twin.model import Model
from hydro_twin.recording.series import Recording, Series
from hydro_twin.ros.worn_rig import NOISE, period, PLANT, STEP, VALUES

TRIAL = 1800.0      # of each challenger, the default of `keep` [s]
LOOK = round(1.0 / STEP)     # samples from one look at the evidence to the next
TRACED = 60.0       # what a challenger is fitted to [s]
MEMORIES = 0.0, 0.2     # of the noise [s]


def noise(rng: np.random.Generator, count: int, memory: float) -> np.ndarray:
    """Draw noise that is forgotten exponentially."""
    kept = math.exp(-STEP / memory) if memory else 0.0
    white = rng.standard_normal(count)
    return np.asarray(NOISE * lfilter([math.sqrt(1.0 - kept**2)], [1.0, -kept], white))


def fitted(one: Series, rng: np.random.Generator, memory: float) -> Model:
    """Fit a model to a stretch of the rig."""
    times = round(TRACED / STEP / len(one))
    columns = {name: np.tile(column, times) for name, column in one.columns.items()}
    columns['T_g'] = columns['T_g'] + noise(rng, len(columns['T_g']), memory)
    parts = parts_of(Recording((Series(columns, STEP),)), PLANT)
    return search(Model(PLANT, VALUES, STEP), excerpt(parts, PLANT, STEP), 15).candidate


def missed(model: Model, one: Series) -> np.ndarray:
    """Say what a free run misses over a period, once it has settled."""
    inputs = np.column_stack([np.tile(one[signal.name], 2) for signal in PLANT.inputs])
    run = free_run(model, Part(inputs, np.tile(one['T_g'], 2)))
    return np.asarray(one['T_g'] - run[len(one):])


def main() -> None:
    """Run it, and print one JSON object."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').splitlines()[0])
    parser.add_argument('--hours', type=float, default=10.0)
    hours = parser.parse_args().hours
    one, results = period(0), []
    inputs = np.column_stack([one[signal.name] for signal in PLANT.inputs])
    grid = grid_of(Recording((one,)), PLANT)
    for memory in MEMORIES:
        rng = np.random.default_rng(0)
        champion = fitted(one, rng, memory)
        ours, outcomes, highest, refused = missed(champion, one), [], 0.0, 0
        for _ in range(round(hours * 3600.0 / TRIAL)):
            theirs = missed(fitted(one, rng, memory), one)
            twin = Twin('', champion.predictor(), 'free_run')      # tells the sample time
            regimes = Regimes(grid, PLANT, STEP, Rules().gain)
            duel = Duel(twin, twin, Rules(), regimes)
            periods = round(TRIAL / STEP / len(one))
            sensor = noise(rng, periods * len(one), memory)
            squares = [((np.tile(missing, periods) + sensor) ** 2).tolist()
                       for missing in (ours, theirs)]
            output = (np.tile(one['T_g'], periods) + sensor).tolist()
            for k, (a, b, measured) in enumerate(zip(*squares, output, strict=True)):
                duel.take(a, b, inputs[k % len(one)], measured)
                if k % LOOK == 0 and (duel.outcome != 'open' or regimes.worse(Rules().alpha)):
                    break
            outcomes.append(duel.outcome)
            refused += bool(regimes.worse(Rules().alpha))
            highest = max(highest, duel.better.e_value)
        results.append({'memory_s': memory, 'judged': len(outcomes),
                        'promoted': outcomes.count('better'), 'worse': outcomes.count('worse'),
                        'worse_in_a_regime': refused,
                        'highest_evidence': highest, 'needed': 1.0 / Rules().alpha})
    print(json.dumps({'hours': hours, 'results': results}))


if __name__ == '__main__':
    main()
