"""What the tracer says of rigs from another integrator that have no law of the library."""
import pytest

from benchmarks.tracing.cases import case_of
from hydro_twin.inference.trace import evidence
from hydro_twin.plants.load_simulator import LOAD_SIMULATOR
from hydro_twin.recording.series import Recording

pytestmark = pytest.mark.slow


def traced(seed, effect):
    case = case_of(seed)
    assert case.effects == (effect,)
    return evidence(Recording(case.rig().recording().series[:2]), None, LOAD_SIMULATOR)


@pytest.mark.measured
def test_flow_that_saturates_softly_is_a_soft_limit_of_the_opening_and_no_orifice():
    """Q / (1 + e |Q|) goes with the opening alone, and so does a limit of that."""
    found = traced(6060, 'soft_flow')
    (finding,) = found.findings
    (placed,) = found.after.candidate.effects
    assert (placed.effect.id, placed.port.name) == ('saturation', 'spool')
    assert placed.named['softness'] > 0.1
    assert found.after.error < 1.1 * found.floor
    assert min(d for rival, d in finding.rivals if rival.effect.id == 'orifice') > 10.0


def test_flow_that_rises_progressively_is_a_curve_and_no_dead_zone():
    found = traced(10209, 'progressive_flow')
    assert found.findings == ()
    placed = found.curve.placed
    assert (placed.port.name, placed.effect.reads) == ('flow', ('opening',))


def test_leakage_of_oil_that_warms_is_a_drift():
    found = traced(6021, 'leak_drift')
    (placed,) = found.after.candidate.effects
    assert (placed.effect.id, placed.port.name) == ('drift', 'K_ce')
    a = case_of(6021).rig().truth.built[0].fields['leak_drift']     # K_ce (1 + a t)
    end = placed.named['end']
    assert placed.named['rate'] == pytest.approx(a / (1.0 + a * end), rel=0.1)


def test_a_spool_that_does_not_seal_has_a_dead_zone_and_no_leakage():
    found = traced(4133, 'dead_zone')
    (placed,) = found.after.candidate.effects
    assert (placed.effect.id, placed.port.name) == ('dead_zone', 'spool')
    slope = case_of(4133).rig().truth.built[0].fields['dead_slope']
    assert placed.named['leak'] == pytest.approx(slope, abs=0.03)
