"""Output and sensors side by side in one fit, each weighted by its own noise.

The noise of each is estimated with the fit. At its best value, the RMS sigma_q of the residual,
the logarithm of the likelihood of N_q samples of each output q is, up to a constant, -sum of
N_q ln sigma_q (the concentrated likelihood). With the scales

    a_q = c / sigma_q,  ln c = sum of N_q ln(sigma_q s_0 / s_q) / sum of N_q

where s_q is the movement of each output, the sum of all squares of a_q r_q is N c^2, so that
N ln of it is that likelihood: fits compare by their sums of squares, in the unit of the output,
as they do with one output, for which a = 1.
"""
from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hydro_twin.arrays import FloatArray, IntArray
from hydro_twin.fitting.autoregression import filtered
from hydro_twin.fitting.parts import edges_of, movement, Part, SCORED
from hydro_twin.plants import Plant
from hydro_twin.predictors.analytical import Analytical
from hydro_twin.predictors.scores import Errors, rms, sensor_errors
from hydro_twin.recording.series import Recording

QUIETEST = 1e-6         # of its movement: no sensor is better, and none takes all the weight


def sensors_in(parts: Sequence[Part], plant: Plant, start_up: int) -> tuple[str, ...]:
    """Name the sensors that are measured often enough to be fitted, in the order of the plant.

    Args:
        parts: what is fitted.
        plant: the plant.
        start_up: first samples of each, which are not scored.
    """
    counts = {sensor.name: sum(int(np.isfinite(part.sensors[sensor.name][start_up:]).sum())
                               for part in parts if sensor.name in part.sensors)
              for sensor in plant.sensors}
    return tuple(name for name, count in counts.items() if count >= SCORED)


def sensor_rms(predictor: Analytical, parts: Mapping[str, Recording]) -> Errors:
    """Score the free run of a model on the sensors in named parts.

    Returns:
        Name of a sensor -> part -> RMS error in its unit; not of a part without it.
    """
    found: Errors = {}
    for part, recording in parts.items():
        errors = sensor_errors(predictor.sensors, predictor.plant, recording)
        for name, (error, _) in errors.items():
            found.setdefault(name, {})[part] = rms(error)
    return found


@dataclass(frozen=True)
class Stack:
    """Output and sensors of one part as rows of one problem.

    Attributes:
        measured: (1 + K, N), nan where there is none.
        rows: where each row is in that, output after output: first samples, then the others.
        first: how many of the rows are first samples, which are not scored.
        counts: scored samples of each output, (1 + K,).
    """

    measured: FloatArray
    rows: IntArray
    first: int
    counts: IntArray

    @classmethod
    def of(cls, part: Part, sensors: Sequence[str], start_up: int) -> Stack:
        """Stack the output of a part and some sensors."""
        missing = np.full(len(part.measured), np.nan)
        measured = np.vstack([part.measured, *(part.sensors.get(name, missing)
                                               for name in sensors)])
        there = np.isfinite(measured)
        is_first = np.arange(len(missing)) < start_up
        first, others = (np.flatnonzero(there & some) for some in (is_first, ~is_first))
        return cls(measured, np.concatenate([first, others]), len(first),
                   (there & ~is_first).sum(axis=1))

    def whitened(self, rows: FloatArray, filters: Sequence[FloatArray]) -> FloatArray:
        """Filter the rows of each output in the order of time, by its own filter."""
        white = rows.copy() if filters else rows
        outputs = self.rows // self.measured.shape[1]
        for q, filter_ in enumerate(filters):
            own = np.flatnonzero(outputs == q)
            own = own[np.argsort(self.rows[own])]
            white[own] = filtered(filter_, rows[own])
        return white


@dataclass(frozen=True)
class Layout:
    """P parts one after another, as one run covers them, and the rows of a fit in it.

    Attributes:
        inputs: of all parts, (N, m).
        measured: output and sensors, nan where there is none, (N, 1 + K).
        edges: where each part begins there, and where the last one ends, (P + 1,).
        rows: where each row of the fit is in what is measured, made flat, part by part.
        of_parts: of each part its first row, its first row that is scored, and the one after its
            last, (P, 3).
    """

    inputs: FloatArray
    measured: FloatArray
    edges: IntArray
    rows: IntArray
    of_parts: IntArray

    @classmethod
    def of(cls, parts: Sequence[Part], stacks: Sequence[Stack]) -> Layout:
        """Lay out parts that are stacked."""
        lengths = [len(part.measured) for part in parts]
        edges = edges_of(lengths)
        rows = []
        for stack, length, begin in zip(stacks, lengths, edges.tolist(), strict=False):
            output, sample = np.divmod(stack.rows, length)
            rows.append((begin + sample) * len(stack.measured) + output)
        begins = edges_of(map(len, rows))
        return cls(np.concatenate([part.inputs for part in parts]),
                   np.concatenate([stack.measured.T for stack in stacks]), edges,
                   np.concatenate(rows), np.column_stack([
                       begins[:-1], begins[:-1] + [stack.first for stack in stacks], begins[1:]]))

    def at(self, parts: IntArray) -> Layout:
        """Lay out some of the parts, each once and in their order."""
        if len(parts) == len(self.of_parts):
            return self
        samples = [np.arange(self.edges[k], self.edges[k + 1]) for k in parts]
        edges = edges_of(map(len, samples))
        spans, width = self.of_parts[parts], self.measured.shape[1]
        rows = np.concatenate([
            self.rows[begin:end] + width * (now - self.edges[k])
            for k, (begin, _, end), now in zip(parts, spans, edges.tolist(), strict=False)])
        begins = edges_of(spans[:, 2] - spans[:, 0])[:-1]
        every = np.concatenate(samples)
        return Layout(self.inputs[every], self.measured[every], edges, rows,
                      spans - spans[:, :1] + begins[:, None])

    def pick(self, values: FloatArray, scales: FloatArray) -> FloatArray:
        """Take the rows of values (N, 1 + K, ...), each times the scale of its output."""
        flat = values.reshape(-1, *values.shape[2:])
        if len(scales) == 1:
            return flat
        weights = scales[self.rows % len(scales)]
        picked: FloatArray = flat[self.rows] * weights.reshape(-1, *[1] * (flat.ndim - 1))
        return picked


@dataclass(frozen=True)
class Pieces:
    """Residuals of all outputs of all parts one after another, part by part.

    Attributes:
        lengths: of each piece, none empty.
        outputs: which output each piece is of: 0, or one more than the index of the sensor.
        sizes: how much each output moves, RMS, (1 + K,).
    """

    lengths: tuple[int, ...]
    outputs: tuple[int, ...]
    sizes: FloatArray

    @classmethod
    def of(cls, stacks: Sequence[Stack]) -> Pieces:
        """Lay out the residuals of some parts."""
        counted = [(int(count), output) for stack in stacks
                   for output, count in enumerate(stack.counts) if count]
        lengths, outputs = zip(*counted, strict=True)
        return cls(lengths, outputs, np.array([
            movement(every) for every in zip(*(stack.measured for stack in stacks),
                                             strict=True)]))

    def spreads(self, residual: FloatArray, scales: FloatArray) -> FloatArray:
        """Return the RMS residual of each output, in its own unit, (1 + K,)."""
        every = np.repeat(self.outputs, self.lengths)
        return np.array([rms(residual[every == q]) / scale for q, scale in enumerate(scales)])

    def likely_scales(self, residual: FloatArray, scales: FloatArray) -> FloatArray:
        """Return the scales of the greatest likelihood, (1 + K,), from those of the residual."""
        if len(scales) == 1:
            return scales
        counts = np.bincount(self.outputs, self.lengths, len(scales))
        sigma = np.maximum(self.spreads(residual, scales), QUIETEST * self.sizes)
        relative = np.log(sigma * self.sizes[0] / self.sizes)
        c = np.exp(float(counts @ relative) / counts.sum())
        found: FloatArray = c / sigma
        return found
