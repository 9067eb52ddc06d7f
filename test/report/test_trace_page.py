"""The page of a trace: needs no other file, has every number, and works in a browser."""
from __future__ import annotations

from dataclasses import replace
from html.parser import HTMLParser
import json
import re
import shutil

import pytest
from trace_by_hand import EFFECTS, evidence, result

from benchmarks.browser import Browser
from hydro_twin.inference.evaluate import result_of
from hydro_twin.model import place
from hydro_twin.report.figures import illustrations
from hydro_twin.report.page import page, parameter_rows, percent, short, spread
from hydro_twin.report.summary import summarise
from hydro_twin.result import BestNamed
from hydro_twin.schema import fault

PROVENANCE = {'bags': [{'path': 'a <bag>', 'sha256': '0123abcd' * 8}], 'test_bags': [], 'seed': 7,
              'command': 'hydro-twin trace "a <bag>"', 'version': '1.2.3'}
CASES = [*((name, found) for name in EFFECTS for found in (True, False)),
         *(('load_simulator', found, True) for found in (True, False))]


def written(name, *what, **more):
    made = result(name, *what, **more)
    summary = summarise(made)
    return page(made, summary, PROVENANCE, illustrations(made)), summary


@pytest.fixture(scope='module', params=CASES, ids=lambda case: '-'.join(map(str, case)))
def case(request):
    return (*request.param, *written(*request.param))


class Tags(HTMLParser):
    """Collects what the page refers to and says, and checks that its tags close."""

    EMPTY = ('meta', 'link', 'br')

    def __init__(self):
        super().__init__()
        self.references, self.open, self.said = [], [], []

    def handle_starttag(self, tag, attrs):
        self.references += [value for name, value in attrs if name in ('src', 'href', 'action')]
        if tag not in self.EMPTY:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] not in ('script', 'style'):
            self.said.append(data)


def read(text):
    tags = Tags()
    tags.feed(text)
    assert tags.open == []
    return tags.references, ' '.join(' '.join(tags.said).split())


def leaves(value):
    if isinstance(value, dict):
        return [leaf for one in value.values() for leaf in leaves(one)]
    if isinstance(value, list):
        return [leaf for one in value for leaf in leaves(one)]
    return [value]


def test_refers_to_nothing_outside(case):
    *_, text, _ = case
    references, _ = read(text)
    assert references == ['data:,']
    assert not re.search(r'https?:|//[a-z]|@import|url\(|fetch\(|XMLHttpRequest', text)


def test_says_every_number_of_the_report(case):
    *_, text, summary = case
    _, said = read(text)
    for value in leaves(summary):
        if isinstance(value, float):
            forms = {short(value), spread(value), percent(value), f'{value:.2g}', '< 1e-99'}
            assert any(form in said for form in forms), value
        elif isinstance(value, str):
            assert value.replace('_', ' ').lower() in said.replace('_', ' ').lower()


def test_begins_with_the_verdict_and_the_two_numbers(case):
    _, found, *_, text, summary = case
    assert summary['verdict'] == ('effect_found' if found else 'unexplained')
    _, said = read(text)
    begin = said[said.index(summary['says']):][:len(summary['says']) + 100]
    judged = 'free_run' if summary['horizon_s'] is None else 'horizon'
    assert (judged == 'horizon') == (summary['plant'] in ('cylinder', 'positioning'))
    assert short(summary['before'][judged]['test']) in begin
    assert short(summary['after'][judged]['test']) in begin


def test_says_where_it_comes_from_and_escapes_it(case):
    *_, text, summary = case
    assert 'a &lt;bag&gt;' in text
    assert ('turn it &lt;slowly&gt; &amp; far' in text) == bool(summary['cannot_show'])
    assert PROVENANCE['bags'][0]['sha256'] in text
    assert '1.2.3, seed 7' in text


def test_names_that_a_curve_took_the_place_of_are_told():
    made = result('cylinder', False, True)
    assert summarise(made)['best_named'] is None
    named = place('asymmetry', 'piston', {'imbalance': 0.25}, made.plant)
    summary = summarise(replace(made, best_named=BestNamed((named,), 0.125)))
    assert summary['effects'] == []
    assert summary['best_named'] == {
        'effects': [{'id': 'asymmetry', 'port': 'piston',
                     'parameters': {'imbalance': {'value': 0.25, 'unit': '1'}}}],
        'held_out_error': 0.125}
    assert ('The best named explanation, an asymmetry at the piston, explains less.'
            in summary['says'])
    assert fault(json.loads(json.dumps(summary)), 'report') == ''


def test_where_the_model_does_not_fit_it_does_not_say_that_all_would_have_shown():
    made = evidence('load_simulator', found=False)
    failed = result_of(replace(made, floor=made.after.error / 8.0))
    _, said = read(page(failed, summarise(failed), PROVENANCE, illustrations(failed)))
    assert 'Not evaluated: the model does not fit' in said
    assert 'would have shown' not in said


def test_its_size():
    text, _ = written('load_simulator', True, seconds=4.5)
    assert len(text.encode()) < 2_000_000


def test_how_much_what_is_lacking_bent_the_parameters():
    made = result('positioning')
    rows = parameter_rows(made, summarise(made)['parameters'])
    viscous = next(row for row in rows if row['name'] == 'F_v')
    values = [model.values['F_v'] for model in (made.before, made.after)]
    assert viscous['shift'] == pytest.approx(values[0] / values[1] - 1.0)
    assert viscous['shift'] > 0.1                # viscous friction stood in for the dry one


def test_a_combination_is_known_as_well_as_the_one_that_was_searched():
    made = result('valve_servo')
    row = parameter_rows(made, summarise(made)['parameters'])[-1]
    values = made.after.values
    assert row['name'] == 'T_c / k_1'
    assert row['after']['value'] == pytest.approx(values['T_c'] / values['k_1'])
    assert 0.0 < row['after']['std_error'] < 0.1 * row['after']['value']


HARNESS = """<script>
const wrong = [];
addEventListener('error', event => wrong.push(event.message));
for (const level of ['error', 'warn']) console[level] = (...what) => wrong.push(what.join(' '));
addEventListener('load', () => setTimeout(() => {
  const found = {};
  const pixels = canvas => canvas.toDataURL();
  const figures = [...document.querySelectorAll('figure > div')];
  found.names = figures.map(figure => figure.id);
  found.widths = [document.documentElement.scrollWidth, document.documentElement.clientWidth];
  found.zoomed = figures.map(figure => {
    const canvases = [...figure.querySelectorAll('canvas')], first = canvases[0];
    const whole = figure.querySelector('.bar button');
    const box = first.getBoundingClientRect();
    const point = (type, share) => first.dispatchEvent(new PointerEvent(type, {
      bubbles: true, button: 0, clientX: box.left + share * box.width, clientY: box.top + 50}));
    const before = canvases.map(pixels), hidden = whole.hidden;
    point('pointerdown', 0.4); point('pointermove', 0.6); point('pointerup', 0.6);
    const during = canvases.map(pixels), shown = !whole.hidden;
    first.dispatchEvent(new MouseEvent('dblclick', {bubbles: true}));
    const after = canvases.map(pixels), again = whole.hidden;
    first.dispatchEvent(new KeyboardEvent('keydown', {key: '+', bubbles: true}));
    const keyed = !whole.hidden;
    whole.click();
    return hidden && shown && again && keyed && whole.hidden &&
      before.every((image, k) => image !== during[k] && image === after[k]);
  });
  const select = document.querySelector('select');
  const drawn = () => pixels(document.querySelector('canvas'));
  const first = drawn();
  select.value = '1';
  select.dispatchEvent(new Event('change'));
  found.other = first !== drawn();
  const key = document.querySelector('.legend button'), full = drawn();
  key.click();
  found.hides = full !== drawn();
  found.wrong = wrong;
  report(found);
}, 200));
</script>"""


@pytest.mark.slow
@pytest.mark.skipif(not shutil.which('chromium'), reason='needs chromium')
@pytest.mark.parametrize('width', [390, 1400])
@pytest.mark.parametrize('found', [True, False])
def test_opens_in_a_browser_and_zooms(tmp_path, width, found):
    text, _ = written('load_simulator', found)
    with Browser(text, HARNESS, tmp_path, width) as browser:
        there = browser.reported()
    assert there['wrong'] == []
    assert all(there['zoomed'])
    assert len(there['zoomed']) == (4 if found else 3)
    assert there['other']
    assert there['hides']
    assert there['widths'][0] <= there['widths'][1]           # nothing sticks out to the side
    assert len(text.encode()) < 2_000_000
