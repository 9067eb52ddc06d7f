"""A small load simulator with known effects, recorded by the independent integrator."""
from __future__ import annotations

from dataclasses import replace

import numpy as np

from hydro_twin.fitting.linear import fit_linear
from hydro_twin.fitting.parts import parts_of
from hydro_twin.inference.search import LONG, search
from hydro_twin.model import place
from hydro_twin.plants import PLANTS
from hydro_twin.recording.series import Recording, split
from hydro_twin.simulation.simulate import simulate

PLANT = PLANTS['load_simulator']
VALUES = PLANT.constant_values() | {p.name: (p.lower * p.upper) ** 0.5 for p in PLANT.parameters}


def record(*effects, seed=0, noise=0.5, count=2, duration=3.0, plant=PLANT, amplitude=0.1,
           bus=0.002, values=VALUES, sensors=None):
    """Record series under random multisines; effects as (id, port, parameters).

    Sensors by name, with the RMS of their noise; the first of them fails half-way.
    """
    rng = np.random.default_rng(seed)
    placed = [place(*effect, plant) for effect in effects]
    series = []
    for index in range(count):
        f, phase = rng.uniform(0.5, 15.0, 8), rng.uniform(0, 2 * np.pi, 8)

        def gate(t):
            return -np.expm1(-(t / 0.1) ** 2)

        def command(t, f=f, phase=phase):
            t = np.floor(t / bus + 1e-6) * bus      # held in between, whatever the plant's rate
            return amplitude * gate(t) * np.sum(np.sin(2 * np.pi * np.outer(t, f) + phase), axis=1)

        def shaft(t):
            return 0.02 * gate(t) * np.sin(2 * np.pi * 1.3 * t)

        one = simulate(plant, values, placed, {'u_m': command, 'theta_d': shaft}, duration,
                       start=10_000_000_000 * (index + 1), sensors=[*(sensors or {})])
        measured = {name: one[name] + rms * rng.standard_normal(len(one))
                    for name, rms in {'T_g': noise, **(sensors or {})}.items()}
        for name in [*measured][1:2]:
            measured[name][len(one) // 2:] = np.nan
        series.append(replace(one, columns={**one.columns, **measured}))
    return Recording(tuple(series))


def fitted(recording):
    """Fit the linear plant; returns (fit, train, test)."""
    train, test = split(recording)
    parts = parts_of(train, PLANT)
    fit = fit_linear(PLANT, parts, PLANT.constant_values(), 0.002)
    return search(fit.candidate, parts, LONG), parts, parts_of(test, PLANT)
