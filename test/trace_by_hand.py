"""Traces put together by hand, so that what a report says of them can be checked quickly."""
from __future__ import annotations

from dataclasses import replace

import numpy as np

from hydro_twin.effects.curve import curve, KNOTS
from hydro_twin.fitting.output_error import residuals
from hydro_twin.fitting.parts import Part
from hydro_twin.fitting.whiteness import is_white
from hydro_twin.inference.curve import FittedCurve
from hydro_twin.inference.evaluate import result_of
from hydro_twin.inference.evidence import Evidence
from hydro_twin.inference.findings import Finding
from hydro_twin.inference.held_out import improvement
from hydro_twin.inference.noise import BurstSamples, noise_floor
from hydro_twin.inference.search import search
from hydro_twin.model import Model, place
from hydro_twin.plants import plant_named
from hydro_twin.recording.series import Recording, Series
from hydro_twin.result import Dependence, Improvement, Line, Undetectable

# For each plant, effects that show under the inputs below, and one that is tried in their place.
EFFECTS = {
    'load_simulator': ([('friction', 'motor', {'coulomb': 10.0}),
                        ('delay', 'command', {'time': 0.006})],
                       ('bias', 'motor', {'offset': 1.0})),
    'valve_servo': ([('saturation', 'stem', {'lower': -10.0, 'upper': 0.6})],
                    ('bias', 'sensor', {'offset': 0.01})),
    'cylinder': ([('asymmetry', 'piston', {'imbalance': 0.2})],
                 ('bias', 'sensor', {'offset': 0.01})),
    'positioning': ([('friction', 'motor', {'coulomb': 20.0})],
                    ('bias', 'motor', {'offset': 1.0})),
}
SIZE = {'load_simulator': 2.0, 'valve_servo': 1.0, 'cylinder': 1.0, 'positioning': 100.0}


def candidate(name, effects=()):
    plant = plant_named(name)
    values = {p.name: float(np.sqrt(p.lower * p.upper)) for p in plant.parameters}
    return Model(plant, {**plant.constant_values(), **values}, plant.sample_time,
                 tuple(place(*effect, plant) for effect in effects), substeps=2)


def parts(truth, seconds, noise, seed, source='a bag'):
    """Run a candidate under three sinusoids, with noise as a share of the output."""
    rng = np.random.default_rng(seed)
    made = []
    for hertz in (1.0, 2.0, 3.0):
        time = truth.sample_time * np.arange(round(seconds / truth.sample_time))
        inputs = np.zeros((len(time), len(truth.plant.inputs)))
        inputs[:, 0] = SIZE[truth.plant.name] * np.sin(2 * np.pi * hertz * time)
        output = truth.system.run(inputs, truth.system.start(inputs[0], 0.0))
        made.append(Part(inputs, output + noise * np.std(output) * rng.standard_normal(len(time)),
                         source))
    return made


def recording(truth, made):
    """Name the columns of parts."""
    names = [signal.name for signal in truth.plant.inputs]
    return Recording(tuple(
        Series({**dict(zip(names, part.inputs.T, strict=True)),
                truth.plant.output.name: part.measured}, truth.sample_time, 0, part.source)
        for part in made))


def unexplained(base, train, port):
    """Add a curve without a name to a fit."""
    reach = max(np.abs(part.inputs[:, 0]).max() for part in train)
    placed = [curve(port, 'value', -reach, reach, height * np.linspace(-1.0, 1.0, KNOTS) ** 3)
              for height in (0.1 * reach, 0.2 * reach)]
    fit = search(replace(base.candidate, effects=(*base.candidate.effects, placed[0])), train, 3)
    return FittedCurve(fit, Improvement(0.4375, 0.3125, 0.5625), 1.5e-9, ((placed[1], 6.25),))


def result(*what, **more):
    """Put evidence together and evaluate it."""
    return result_of(evidence(*what, **more))


def evidence(name, found=True, curve=False, seconds=0.6, source='a bag'):
    """Put evidence together: effects found, or the same data with nothing found, or a curve."""
    effects, rival = EFFECTS[name]
    truth = candidate(name, effects)
    train, test = (parts(truth, seconds, 0.01, seed, source) for seed in (1, 2))
    before = search(candidate(name), train, 10)
    after = search(truth, train, 3) if found else before
    other = place(*rival, truth.plant)
    port = truth.plant.ports[0]
    return Evidence(
        plant=truth.plant, before=before, after=after, train=train, test=test,
        recordings={'train': recording(truth, train), 'test': recording(truth, test)},
        fitted=train,
        undetectable=(Undetectable('ripple', 'motor', 'turn it <slowly> & far'),),
        findings=tuple(Finding(k, 1.25e-30, 0.875, ((other, 43.25 + k),))
                       for k in range(len(effects))) if found else (),
        improvement=improvement(residuals(before.candidate, test),
                                residuals(after.candidate, test), 0),
        by_horizon=truth.plant.integrates, held_out_ratio=1.0,
        floor=noise_floor(after.by_part),
        white=is_white(after.by_part),
        lines=() if found else (Line(50.25, 0.125),),
        bursts=() if found else (BurstSamples(0, 50, 100),),
        depends_on=() if found and not curve else (
            Dependence(port, 'value', 0.625, 3.5e-7, np.linspace(-1.0, 1.0, 5),
                       np.arange(5.0)),),
        drifts=(0.001, 0.5), by_ports=(0.002, 0.75),
        curve=unexplained(after, train, port) if curve else None)
