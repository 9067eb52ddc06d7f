import numpy as np
import pytest

from benchmarks.tracing.cases import case_of, cases, KINDS
from benchmarks.tracing.figures import outcome, report
from benchmarks.tracing.laws import integrate, SAMPLE_TIME, SUBSTEPS
from benchmarks.tracing.linear_fit import sampled, shows, UNITS
from benchmarks.tracing.rigs import make_rig
from benchmarks.tracing.true_fit import error, true_structure


def line(kind, there, names, verdict='effect_found', ambiguous=(), certain=True):
    return {
        'seed': 1, 'kind': kind, 'effects': there, 'snr_db': 46.0, 'excitation': 'b19',
        'shows': 0.5, 'shows_alone': dict.fromkeys(there, 0.5), 'seconds': 1.0,
        'true_error': 0.1,
        'report': {
            'verdict': verdict, 'ambiguous': ambiguous,
            'effects': [{'id': name, 'certain': certain} for name in names],
            'after': {'free_run': {'test': 0.1}}}}


@pytest.mark.parametrize(('of', 'judged'), [
    (line('single', ['friction'], ['friction']), 'right'),
    (line('single', ['friction'], ['friction', 'bias']), 'right'),
    (line('single', ['friction'], ['bias', 'friction']), 'wrong'),
    (line('variant', ['delay'], ['bias'], ambiguous=[['bias', 'delay']]), 'ambiguous'),
    (line('single', ['friction'], [], 'unexplained'), 'unexplained'),
    (line('none', [], [], 'nothing_missing'), 'nothing_missing'),
    (line('none', [], ['bias']), 'wrong'),
    (line('outside', ['line'], ['ripple']), 'wrong'),
    (line('outside', ['resonance'], ['mode']), 'right'),
    (line('outside', ['leak_drift'], ['drift']), 'right'),
    (line('outside', ['resonance'], ['delay']), 'wrong'),
    (line('outside', ['line'], ['mode']), 'wrong'),
    (line('pair', ['bias', 'delay'], ['delay', 'bias']), 'right'),
    (line('pair', ['bias', 'delay'], ['delay']), 'part'),
    (line('pair', ['bias', 'delay'], ['friction']), 'wrong'),
    (line('triple', ['bias', 'delay', 'gain'], ['delay', 'gain', 'bias']), 'right'),
    (line('triple', ['bias', 'delay', 'gain'], ['delay', 'bias']), 'part'),
    ({'failure': 'ValueError'}, 'failure'),
])
def test_outcome(of, judged):
    assert outcome(of) == judged


def test_report_counts():
    lines = [line('none', [], ['bias'] if i == 0 else []) for i in range(4)]
    lines += [line('outside', ['line'], ['ripple'], certain=i == 0) for i in range(2)]
    text = report(lines)
    assert '| nothing added: an effect named | 25.0 % (1) | 4 |' in text
    assert '| outside: an effect certain | 50.0 % (1) | 2 |' in text
    assert '| outside: an effect named | 100.0 % (2) | 2 |' in text


def test_report_compares_with_the_true_structure():
    near, far = (line('single', ['delay'], ['delay']) for _ in range(2))
    far['true_error'] = 0.08
    unknown = line('single', ['delay'], ['delay']) | {'true_error': None}
    assert "within 10 % of the true structure's | 50.0 % (1) | 2 |" in report([near, far, unknown])


def test_true_structure_is_the_rig():
    rig = make_rig(22, 'pair', ('dead_zone', 'ripple'))
    assert not rig.truth.running
    left = error(true_structure(rig), rig.recording())
    assert left == pytest.approx(rig.truth.noise_rms, rel=0.03)


def test_cases_are_distinct_and_known_by_their_seed():
    some = [case for seeds in ('development', 'held_out') for kind in KINDS
            for case in cases(seeds, kind, 156)]
    assert len({case.seed for case in some}) == len(some)
    assert all(case_of(case.seed) == case for case in some)
    singles = {(c.effects, c.excitation, c.snr_db) for c in some if c.kind == 'single'}
    assert len(singles) == 13 * 4 * 3


def test_sampled_laws_are_the_integrated_ones():
    rig = make_rig(5, 'none')
    laws = rig.truth.laws
    n = 200
    u = 0.1 * np.sin(0.05 * np.arange(n))
    angle = np.interp(np.arange(2 * n * SUBSTEPS + 1) / (2 * SUBSTEPS), np.arange(n),
                      0.01 * np.sin(0.1 * np.arange(n)))
    states, _ = integrate(laws, np.repeat(u, SUBSTEPS), angle, 0.0, SAMPLE_TIME / SUBSTEPS,
                          SUBSTEPS)
    F, B0, B1 = sampled(laws, linear_command=False)
    v = np.stack([u, angle[::2 * SUBSTEPS][:n]], axis=1)
    x = np.zeros(4)
    for k in range(n - 1):
        x = F @ x + B0 @ v[k] + B1 @ (v[k + 1] - v[k])
    np.testing.assert_allclose(x * UNITS, states[-1, :4], rtol=1e-4)


def test_only_an_effect_shows():
    assert abs(shows(make_rig(3, 'none'))) < 0.01
    assert shows(make_rig(3, 'single', ('saturation',))) > 0.03
