"""The fit of the linear load simulator, against CasADi's: same data, unknowns, start and end.

    uv run --group bench python -m benchmarks.casadi_fit

CasADi runs the equations by the classical Runge-Kutta method, four steps in a sample, mapped over
the samples, with forward derivatives by the physical parameters and the state at the start, in
generated C where there is a compiler. Both searches are scipy's trust region. Times are those of
the processor, best of three, compiled or built before; how long that takes is given by itself.
"""
from __future__ import annotations

from dataclasses import replace
from importlib.metadata import version
import shutil
import time
from types import SimpleNamespace
from typing import Any

import casadi
import numpy as np
from scipy.optimize import least_squares

from benchmarks.engine import PLANT, problem, timed
from hydro_twin.arrays import FloatArray
from hydro_twin.blas import one_thread
from hydro_twin.fitting.output_error import initial_states
from hydro_twin.fitting.problem import Problem
from hydro_twin.fitting.unknowns import plant_unknowns

STEPS = 4                               # of Runge and Kutta in a sample
SCALE = np.array([1e-5, 1e6, 0.1, 0.01])        # of the states


def linear() -> Problem:
    """Make the fit: the data of `benchmarks.engine` without what its effects add."""
    fit = problem()
    base = replace(fit.base, effects=(), timing={})
    part, = fit.parts
    made = replace(base, values=PLANT.constant_values() | PLANT.middle())
    noise = 0.5 * np.random.default_rng(1).standard_normal(len(part.measured))
    clean = made.system.run(part.inputs, np.zeros(PLANT.order))
    return Problem(base, plant_unknowns(PLANT, 'physical'),
                   [replace(part, measured=clean + noise)])


def rates(p: SimpleNamespace, x: Any, u: Any) -> Any:
    """Return the rates of the states, [B19] eqs 11 to 15."""
    x_v, p_L, omega_j, theta_j = (x[k] for k in range(4))
    torque = p.G * (theta_j - u[1])
    return casadi.vertcat(
        (p.K_sv * u[0] - x_v) / p.K_p,
        4.0 * p.beta_e / p.V_m * (p.K_q * x_v - p.K_ce * p_L - p.D_m * omega_j),
        (p.D_m * p_L - p.B_m * omega_j - torque) / p.J,
        omega_j)


def simulation(fit: Problem) -> Any:
    """Build the function of (coordinates, scaled start) that returns output and derivatives."""
    part, = fit.parts
    names = [unknown.name for unknown in fit.unknowns]
    unknowns = casadi.SX.sym('c', len(names))
    values = dict(fit.base.values) | {
        name: casadi.exp(unknowns[k]) for k, name in enumerate(names)}
    x, u0, u1 = casadi.SX.sym('x', 4), casadi.SX.sym('u0', 2), casadi.SX.sym('u1', 2)
    h, now = PLANT.sample_time / STEPS, x
    p = SimpleNamespace(**values)
    for k in range(STEPS):
        def between(share: float, k: int = k) -> Any:
            """Hold the command, and interpolate the angle."""
            return casadi.vertcat(u0[0], u0[1] + (k + share) / STEPS * (u1[1] - u0[1]))

        k1 = rates(p, now, between(0.0))
        k2 = rates(p, now + 0.5 * h * k1, between(0.5))
        k3 = rates(p, now + 0.5 * h * k2, between(0.5))
        k4 = rates(p, now + h * k3, between(1.0))
        now = now + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    step = casadi.Function('step', [x, u0, u1, unknowns], [now])
    count = len(part.measured) - 1
    start, coordinates = casadi.MX.sym('start', 4), casadi.MX.sym('coordinates', len(names))
    inputs = part.inputs.T
    states = step.mapaccum(count)(SCALE * start, inputs[:, :-1], inputs[:, 1:],
                                  casadi.repmat(coordinates, 1, count))
    states = casadi.horzcat(SCALE * start, states)
    G = casadi.exp(coordinates[names.index('G')])
    y = (G * (states[3, :] - inputs[1:2, :])).T
    both = casadi.vertcat(coordinates, start)
    compiler = {'jit': True, 'compiler': 'shell', 'jit_options': {'flags': ['-O2']}}
    return casadi.Function('run', [both], [y, casadi.jacobian(y, both)],
                           compiler if shutil.which('gcc') else {})


def by_casadi(fit: Problem, run: Any) -> Any:
    """Search the same unknowns with the same penalty."""
    part, = fit.parts
    begin = np.array([unknown.coordinate(fit.base.values[unknown.name])
                      for unknown in fit.unknowns])
    start = initial_states(fit.base, fit.parts)
    lower, upper = fit.bounds()
    known: dict[bytes, tuple[FloatArray, FloatArray]] = {}

    def at(both: FloatArray) -> tuple[FloatArray, FloatArray]:
        if both.tobytes() not in known:
            known.clear()
            y, slopes = run(both)
            known[both.tobytes()] = (np.array(y)[:, 0], np.array(slopes.full()))
        return known[both.tobytes()]

    def residual(both: FloatArray) -> FloatArray:
        return np.concatenate([part.measured - at(both)[0], fit.penalty(both[:len(begin)])])

    def jacobian(both: FloatArray) -> FloatArray:
        penalty = np.hstack([fit.penalty_jacobian(both[:len(begin)]),
                             np.zeros((2 * len(begin), PLANT.order))])
        return np.vstack([-at(both)[1], penalty])

    far = np.full(PLANT.order, np.inf)
    return least_squares(residual, np.concatenate([begin, start.x[0] / SCALE]), jacobian,
                         bounds=(np.append(lower, -far), np.append(upper, far)), ftol=1e-6,
                         max_nfev=40)


@one_thread()
def main() -> None:
    """Print the figures."""
    fit = linear()
    part, = fit.parts
    compiling, found = timed(lambda: fit.search(40, 1e-6), 1)
    own, found = timed(lambda: fit.search(40, 1e-6))
    begin = time.perf_counter()
    run = simulation(fit)
    building = time.perf_counter() - begin
    other, there = timed(lambda: by_casadi(fit, run))
    start_up = fit.base.start_up
    error = np.sqrt(np.mean(there.fun[start_up:len(part.measured)] ** 2))
    print(f'{len(fit.unknowns)} unknowns and the state at the start, {len(part.measured)} '
          f'samples: {own:.3f} s to an error of {np.sqrt(np.mean(found.residual ** 2)):.4f} '
          f'(the first time {compiling:.1f} s, compiled or read from the cache)')
    how = 'in C' if shutil.which('gcc') else 'interpreted'
    how = 'in C' if shutil.which('gcc') else 'interpreted'
    print(f'CasADi {version("casadi")}, {how}: {other:.3f} s to {error:.4f} in {there.nfev} '
          f'steps, built in {building:.1f} s: {other / own:.1f} times as long')


if __name__ == '__main__':
    main()
