"""What a plant with effects does under given inputs: its laws, integrated in continuous time."""
from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from hydro_twin.arrays import FloatArray
from hydro_twin.effects import Placed
from hydro_twin.effects.dispatch import code
from hydro_twin.errors import UserError
from hydro_twin.plants.plant import Laws, Plant
from hydro_twin.recording.series import Series
from hydro_twin.simulation.integrator import integrate

Excitation = Callable[[FloatArray], FloatArray]     # times [s] -> values of one input

LONGEST_STEP = 0.0125   # of the plant's sample time: 25 us at 2 ms, which resolves a stiff effect
USUAL = 0.002                               # [s]: a plant sampled faster needs no shorter steps
FASTEST = 0.05                              # step times fastest pole of the linear laws, at most
BLOCK = 500                                 # samples integrated at once


def simulate(plant: Plant, values: Mapping[str, float], effects: Sequence[Placed],
             inputs: Mapping[str, Excitation], duration: float, start: int = 0,
             tick: Callable[[], None] = lambda: None,
             sample_time: float | None = None, sensors: Sequence[str] = ()) -> Series:
    """Integrate a plant from rest, and sample inputs and what is measured without any error.

    A held input keeps each sample until the next, as the plant gets it from a bus; the others
    move on between samples.

    Args:
        plant: the plant.
        values: parameters and constants by name.
        effects: what the linear plant lacks.
        inputs: for every input, its value over time.
        duration: number of samples times the sample time [s].
        start: stamp of the first sample [ns].
        tick: called after every `BLOCK` samples.
        sample_time: of the series [s]; by default the plant's own.
        sensors: what else is measured, of those that the plant declares.

    Raises:
        UserError: the duration is shorter than a sample, or an effect is a drift.
    """
    T = sample_time or plant.sample_time
    count = round(duration / T)
    if count < 1:
        raise UserError(f'a duration of {duration:g} s is shorter than a sample, {T:g} s')
    if any(placed.effect.course for placed in effects):
        raise UserError('a drift cannot be simulated: parameters are constant here')
    laws = plant.laws(values)
    rows = [[sensor.name for sensor in plant.sensors].index(name) for name in sensors]
    fastest = float(np.abs(np.linalg.eigvals(laws.A)).max())
    longest = min(LONGEST_STEP * max(plant.sample_time, USUAL), FASTEST / max(fastest, 1e-9))
    steps = int(np.ceil(T / longest))
    h = T / steps
    table, p, memory = _tables(plant, effects)
    rate_rows = np.hstack([laws.A, laws.B, laws.E])
    at_ports = np.hstack([laws.port_x, laws.port_u, laws.port_d])
    signals = np.hstack([laws.signal_x, laws.signal_u, laws.signal_d])
    observed = (at_ports, np.vstack([at_ports, signals]),
                np.hstack([laws.sensor_x, laws.sensor_u, laws.sensor_d])[rows])
    gain = np.zeros((len(plant.ports), rate_rows.shape[1]))
    gain[:, :plant.order] = _response(laws, h).T
    x, z = np.zeros(plant.order), np.zeros(memory)
    y = np.empty((count, 1 + len(rows)))
    work = np.zeros((7, max(rate_rows.shape[1], memory)))
    # A step of no length evaluates the output at the start, where nothing has moved yet.
    at_start = np.array([[[inputs[s.name](np.zeros(1))[0] for s in plant.inputs]] * 3])
    integrate(rate_rows, observed, table, p, 0.0, 0.0 * gain, x, z, at_start, 1, y[:1], work)
    for k in range(0, count - 1, BLOCK):
        samples = min(BLOCK, count - 1 - k)
        fine = _fine(plant, effects, inputs, T, k, samples, steps)
        integrate(rate_rows, observed, table, p, h, gain, x, z, fine, steps,
                  y[k + 1:k + 1 + samples], work)
        tick()
    time = T * np.arange(count, dtype=np.float64)
    columns = {signal.name: inputs[signal.name](time) for signal in plant.inputs}
    columns |= {name: np.ascontiguousarray(column)
                for name, column in zip((plant.output.name, *sensors), y.T, strict=True)}
    return Series(columns, T, start)


def _fine(plant: Plant, effects: Sequence[Placed], inputs: Mapping[str, Excitation], T: float,
          k: int, samples: int, steps: int) -> FloatArray:
    """Lay out the inputs as the plant feels them from sample k on, shape (steps samples, 3, m)."""
    step = np.arange(samples * steps)
    places = [k + (step + offset) / steps for offset in (0.0, 0.5, 1.0)]     # in samples
    columns = []
    for signal in plant.inputs:
        late = sum(placed.values[0] for placed in effects
                   if placed.effect.shifts == 'all' or (placed.effect.shifts and signal.held)) / T
        at = np.column_stack([place - late for place in places])
        if signal.held:                     # no step straddles a sample: its middle shows which
            at = np.repeat(np.floor(at[:, 1:2]), 3, axis=1)
        columns.append(inputs[signal.name](T * np.maximum(at, 0.0).ravel()).reshape(at.shape))
    return np.ascontiguousarray(np.stack(columns, axis=-1))


def _tables(plant: Plant, effects: Sequence[Placed]
            ) -> tuple[npt.NDArray[np.int64], FloatArray, int]:
    """Lay out effects for `integrate`: its table, their parameters, the size of their memory."""
    rows: list[list[int]] = []
    p: list[float] = []
    memory = 0
    for placed in effects:
        if placed.effect.law is None:
            continue
        signals = [plant.signal_row(placed.port, name) for name in placed.effect.reads]
        rows.append([code(placed.effect), plant.ports.index(placed.port), *[*signals, -1, -1][:2],
                     len(p), len(p) + len(placed.values),
                     memory, memory + placed.effect.memory, placed.effect.implicit])
        p += placed.values
        memory += placed.effect.memory
    return np.array(rows, np.int64).reshape(-1, 9), np.array(p, np.float64), memory


def _response(laws: Laws, h: float) -> npt.NDArray[np.floating]:
    """Return what a unit added to each port over h does to x: h E + h^2/2 A E + ..."""
    term = h * laws.E
    gain = term
    for k in range(2, 6):
        term = h / k * laws.A @ term
        gain = gain + term
    return gain
