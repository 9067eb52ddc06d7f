"""What the search of a trace ends with: fits, findings, and the tests of the last residual."""
from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import math

from hydro_twin.fitting.autoregression import effective_samples
from hydro_twin.fitting.fit import Fit
from hydro_twin.fitting.identifiability import Identifiability
from hydro_twin.fitting.parts import Part
from hydro_twin.inference.curve import FittedCurve
from hydro_twin.inference.findings import Finding
from hydro_twin.inference.noise import BurstSamples, MAX_COLOURED_NOISE_RATIO
from hydro_twin.inference.stepwise import MAX_HELD_OUT_RATIO
from hydro_twin.plants import Plant
from hydro_twin.recording.series import Recording
from hydro_twin.result import (
    BestNamed,
    Dependence,
    Improvement,
    Line,
    Memory,
    TestPart,
    Undetectable,
)

MAX_NOISE_RATIO = 6.0   # error over that of the noise, beyond which it cannot all be noise
ALL = 1.0 - 1e-9        # share of a residual beyond which its logarithm is rounding


@dataclass(frozen=True)
class Evidence:
    """What tracing found, as it was found.

    Attributes:
        before, after: the fit at the start and at the end, on the training parts.
        train, test: the parts, in the order of the series.
        recordings: what these parts are of, by 'train' and 'test'; what is reported is scored on
            them.
        fitted: what of the training parts was fitted: all, or stretches of a long recording.
        undetectable: effects that the recording could not have shown, if the model fits.
        improvement: of what is judged, see `TraceResult`, by what was named and by the curve.
        by_horizon: whether that is the error over a horizon, see `judged_errors`.
        held_out_ratio: RMS of the residual of `after` on the test parts, sampled as the training
            parts were, with their initial states fitted, over that on the training parts; both
            whitened, where that was fitted as coloured noise.
        floor: estimated RMS of the noise.
        bursts: when much of what is left comes, if seldom; in `train`, then in `test`.
        depends_on: what the residual of `after` still depends on.
        drifts: (share, p-value) of a drift of the parameters in what is left.
        by_ports: (share, p-value) of what is left that the port signals predict.
        curve: a curve without a name, on top of `after`.
        known: what all recordings determine of `final`, where earlier ones were used; None: what
            the parts that were fitted do.
        tested, best_named, memory: see `TraceResult`.
    """

    plant: Plant
    before: Fit
    after: Fit
    train: Sequence[Part]
    test: Sequence[Part]
    recordings: Mapping[str, Recording]
    fitted: Sequence[Part]
    undetectable: tuple[Undetectable, ...]
    findings: tuple[Finding, ...]
    improvement: Improvement
    by_horizon: bool
    held_out_ratio: float
    floor: float
    white: bool
    lines: tuple[Line, ...]
    bursts: tuple[BurstSamples, ...]
    depends_on: tuple[Dependence, ...]
    drifts: tuple[float, float]
    by_ports: tuple[float, float]
    curve: FittedCurve | None = None
    tested: TestPart = 'recordings'
    best_named: BestNamed | None = None
    known: Identifiability | None = None
    memory: Memory | None = None

    @property
    def final(self) -> Fit:
        """The model with all that was found, named or not."""
        return self.after if self.curve is None else self.curve.fit

    @property
    def evidence_left(self) -> float:
        """What the port signals predict of what is left, as a log-likelihood [nats]."""
        share = min(max(self.by_ports[0], 0.0), ALL)
        return 0.5 * effective_samples(self.after.by_part) * math.log(1.0 / (1.0 - share))

    @property
    def additions(self) -> int:
        """How much was added to the model, named or not."""
        return len(self.findings) + (self.curve is not None)

    @property
    def fails(self) -> bool:
        """Whether the model does not fit, and nothing was found that improves it.

        Which effects would be detectable is then not evaluated: the residual is not noise.
        """
        return self.additions == 0 and self.exceeds_any_noise

    @property
    def exceeds_any_noise(self) -> bool:
        """Whether more is left than noise that is even remotely white."""
        return self.after.error > MAX_NOISE_RATIO * self.floor

    @property
    def exceeds_noise(self) -> bool:
        """Whether more is left than white noise, or noise of a short memory."""
        return self.after.error > MAX_COLOURED_NOISE_RATIO * self.floor

    @property
    def is_larger_held_out(self) -> bool:
        """Whether the model fails on held-out data, in which more must happen."""
        return not self.held_out_ratio <= MAX_HELD_OUT_RATIO
