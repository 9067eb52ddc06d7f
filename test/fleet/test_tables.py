"""What comes of many results: the order of rigs, trends, the page, and the same in both tables."""
from html.parser import HTMLParser
import json
import shutil

from fleet_by_hand import outcome, task
import numpy as np
import pytest

from benchmarks.browser import Browser
from hydro_twin.fleet.page import page, ROWS
from hydro_twin.fleet.summary import summarise
from hydro_twin.fleet.tables import write_tables
from hydro_twin.fleet.task import Outcome

DATES = ('2025-01-01', '2025-04-01', '2025-07-01', '2025-10-01', '2026-01-01')
GAP = 'backlash at stem: gap'


def fleet(rigs=10, grows=3, fails=5):
    """Make a fleet: gaps of 1 % that scatter by 10 %; one doubles each quarter, a trace fails."""
    rng = np.random.default_rng(0)
    done = []
    for k in range(rigs):
        own = np.exp(rng.normal(0.0, 0.1, 2))
        for period, date in enumerate(DATES):
            value = own * np.exp(rng.normal(0.0, 0.02, 2)) * [1.0, 0.01]
            value[1] *= 2.0 ** period if k == grows else 1.0
            done.append((task(f'rig <{k}>', date, site='x & y'), outcome(
                {'T': (value[0], 0.005 * value[0]), GAP: (value[1], 0.01 * value[1])}, [1])))
        if k == fails:
            done[-1] = (done[-1][0], Outcome(None, reason='/bags/<x> is damaged'))
    return summarise(done)


def test_the_rig_that_grows_comes_first_with_its_trend():
    made = fleet()
    first = made['rigs'][0]
    assert first['rig'] == 'rig <3>'
    assert first['score']['name'] == GAP
    assert first['score']['out']
    assert first['trend']['name'] == GAP
    assert first['trend']['per_year'] == pytest.approx(15.0, rel=0.1)   # sixteenfold
    others = made['rigs'][1:]
    assert not any(rig['score']['out'] for rig in others)
    assert [rig['rig'] for rig in others if rig['trend'] and abs(rig['trend']['score']) > 4] == []
    scores = [abs(rig['score']['value']) for rig in made['rigs']]
    assert scores == sorted(scores, reverse=True)


def test_few_fleets_mark_a_rig_that_is_as_the_others():
    marked = 0
    for seed in range(100):
        rng = np.random.default_rng(seed)
        done = [(task(str(k)), outcome({name: (np.exp(rng.normal(0.0, 0.1)), 0.01)
                                        for name in 'abcd'})) for k in range(8)]
        marked += any(rig['score']['out'] for rig in summarise(done)['rigs'])
    assert marked <= 12


def test_a_failed_trace_is_in_its_row_and_the_earlier_ones_stay():
    made = fleet()
    (rig,) = [rig for rig in made['rigs'] if rig['problems']]
    assert rig['problems'] == [{'date': DATES[-1], 'reason': '/bags/<x> is damaged'}]
    assert [period['date'] for period in rig['periods']] == list(DATES[:-1])
    assert rig['last_bag'] == DATES[-1]
    assert made['traces'] == {'done': 49, 'traced_now': 49, 'failed': 1}
    (alone,) = summarise([(task('a'), Outcome(None, reason='no'))])['rigs']
    assert (alone['verdict'], alone['says'], alone['report']) == ('failed', 'no', None)


def test_a_period_with_another_model_makes_no_trend():
    """Without the effect that is there, other parameters stand in for it."""
    done = [(task(str(k), date), outcome(
        {'T': (3.0 if k == 1 and date == DATES[0] else 1.0 + 1e-3 * (k + n % 2), 1e-3)},
        [] if k == 1 and date == DATES[0] else [1]))
        for k in range(4) for n, date in enumerate(DATES)]
    assert [rig['trend'] for rig in summarise(done)['rigs']] == [None] * 4


def test_an_effect_that_only_one_has_is_scored():
    done = [(task(str(k)), outcome({'T': (1.0 + 0.01 * k, 0.1)}, [1] if k == 2 else []))
            for k in range(8)]
    first = summarise(done)['rigs'][0]
    assert (first['rig'], first['score']['name']) == ('2', 'backlash at stem')
    assert not first['score']['out']


def test_the_probability_is_that_of_the_least_certain_effect_or_of_nothing(tmp_path):
    parquet = pytest.importorskip('pyarrow.parquet')
    made = summarise([(task(name), outcome({'T': (1.0, 0.1)}, effects)) for name, effects in
                      (('none', []), ('one', [0.996]), ('two', [0.996, 0.25]))]
                     + [(task('failed'), Outcome(None, reason='no'))])
    expected = {'none': 0.875, 'one': 0.996, 'two': 0.25, 'failed': None}
    assert {rig['rig']: rig['probability'] for rig in made['rigs']} == expected
    write_tables(made, tmp_path)
    rows = parquet.read_table(tmp_path / 'fleet.parquet').to_pylist()
    assert {row['rig']: row['probability'] for row in rows} == expected
    cells = Cells()
    cells.feed(page(made))
    assert {row[0].strip(): row[6] for row in cells.rows if len(row) == 10} == {
        'none': '0.875', 'one': '0.996', 'two': '0.25', 'failed': '–'}


def test_values_of_either_sign_are_compared_as_they_are():
    usual = summarise([(task(str(k)), outcome({'bias': (k - 2.0, 0.1)})) for k in range(5)])
    assert not usual['groups']['a']['bias']['log']
    assert usual['groups']['a']['bias']['mean'] == pytest.approx(0.0, abs=1e-9)


def test_earlier_periods_count_as_long_as_they_agree():
    """Of five, one in the middle is off; with what came after it the rig is known better."""
    done = [(task(str(k), date), outcome({'T': (
        (3.0 if k == 1 and date == DATES[1] else 1.0) * (1.0 + 0.3 * k), 0.01 * (1.0 + 0.3 * k))}))
        for k in range(4) for date in DATES]
    rigs = {rig['rig']: rig for rig in summarise(done)['rigs']}
    assert [rigs[str(k)]['pooled'] for k in range(4)] == [5, 3, 5, 5]
    for k, periods in ((1, 3), (2, 5)):
        usual = rigs[str(k)]['usual']['T']
        assert usual['value'] == pytest.approx(1.0 + 0.3 * k, rel=1e-3)
        assert usual['std_error'] == pytest.approx(
            0.01 * (1.0 + 0.3 * k) / periods ** 0.5, rel=1e-2)


def test_a_parameter_that_a_recording_does_not_determine_is_borrowed():
    """One rig has the product of two parameters only, and the error of neither by itself."""
    rng = np.random.default_rng(3)
    done = [(task(str(k)), outcome({name: (np.exp(0.02 * rng.normal()), 0.005)
                                    for name in ('K', 'T')})) for k in range(8)]
    done.append((task('poor'), outcome({})))
    done[-1][1].record['factor'] = {'names': ['K', 'T'], 'values': [4.0, 0.27],
                                    'rows': [[200.0 / 4.0, 200.0 / 0.27]], 'step': [0.0]}
    (poor,) = [rig for rig in summarise(done)['rigs'] if rig['rig'] == 'poor']
    assert set(poor['usual']) == {'K', 'T'}
    for one in poor['usual'].values():
        assert one['value'] == pytest.approx(1.0, abs=0.1)
        assert one['score'] is None
        assert one['std_error'] < 0.05
    assert poor['usual']['K']['value'] * poor['usual']['T']['value'] == pytest.approx(
        4.0 * 0.27, rel=0.01)


class Cells(HTMLParser):
    """Collects the text of the cells by rows, and the links."""

    def __init__(self):
        super().__init__()
        self.rows, self.links, self.inside = [], [], False

    def handle_starttag(self, tag, attrs):
        if tag == 'tr':
            self.rows.append([])
        elif tag == 'td':
            self.rows[-1].append('')
        self.inside = {'td': True, 'script': False, 'h2': False}.get(tag, self.inside)
        self.links += [value for name, value in attrs if name in ('href', 'src')]

    def handle_endtag(self, tag):
        self.inside = self.inside and tag != 'td'

    def handle_data(self, data):
        if self.inside:
            self.rows[-1][-1] += data


def test_the_page_has_a_row_for_each_rig_with_links_to_its_reports():
    made = fleet()
    cells = Cells()
    cells.feed(page(made))
    rows = [row for row in cells.rows if len(row) == 11]
    assert [row[0].split('>')[0] + '>' for row in rows] == [rig['rig'] for rig in made['rigs']]
    assert 'x & y' in rows[0][2]
    assert GAP in rows[0][3]
    assert any('/bags/<x> is damaged' in row[4] for row in rows)
    assert {link for link in cells.links if not link.startswith('data:')} == {
        period['report'] for rig in made['rigs'] for period in rig['periods']}


def test_json_and_parquet_hold_the_same(tmp_path):
    parquet = pytest.importorskip('pyarrow.parquet')
    made = fleet()
    write_tables(made, tmp_path)
    assert json.loads((tmp_path / 'fleet.json').read_text('utf-8')) == made
    rows = parquet.read_table(tmp_path / 'fleet.parquet').to_pylist()
    assert {(row['rig'], row['date'], row['parameter'], row['value']) for row in rows
            if row['parameter']} == {
        (rig['rig'], period['date'], name, one['value']) for rig in made['rigs']
        for period in rig['periods'] for name, one in period['estimates'].items()}
    assert {(row['rig'], row['parameter']): row['score'] for row in rows
            if row['score'] is not None} == {
        (rig['rig'], name): one['score'] for rig in made['rigs']
        for name, one in rig['usual'].items()}
    assert [row['problem'] for row in rows if row['problem']] == ['/bags/<x> is damaged']
    assert {row['label_site'] for row in rows} == {'x & y'}
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        'fleet.html', 'fleet.json', 'fleet.parquet']


HARNESS = """<script>
const wrong = [];
addEventListener('error', event => wrong.push(event.message));
addEventListener('load', () => setTimeout(() => {
  const rows = () => [...document.querySelectorAll('.rigs tbody tr')];
  const names = () => rows().map(r => r.cells[0].querySelector('a').textContent);
  const heads = [...document.querySelectorAll('.rigs th button')];
  const canvas = document.querySelector('.rigs canvas');
  draw(canvas, DATA.rigs[0]);
  const found = {wrong, drawn: canvas.getContext('2d').getImageData(
    0, 0, canvas.width, canvas.height).data.some(v => v)};
  found.first = names();
  new MutationObserver((changes, observer) => {
    if (rows().length < DATA.rigs.length) return;
    observer.disconnect();
    found.scrolled = names();
    heads[0].click(); found.up = names();
    heads[0].click(); found.down = names();
    heads[3].click(); found.score = names();
    const filter = document.getElementById('filter');
    filter.value = '<3>'; filter.dispatchEvent(new Event('input')); found.filtered = names();
    report(found);
  }).observe(document.querySelector('.rigs tbody'), {childList: true});
  scrollTo(0, document.body.scrollHeight);
}));
</script>"""


@pytest.mark.slow
@pytest.mark.skipif(not shutil.which('chromium'), reason='needs chromium')
def test_rows_are_sorted_and_filtered_in_a_browser(tmp_path):
    made = fleet(70)
    with Browser(page(made), HARNESS, tmp_path) as browser:
        found = browser.reported()
    assert found['wrong'] == []
    assert found['drawn']
    names = [rig['rig'] for rig in made['rigs']]
    assert found['first'] == found['score'] == names[:ROWS]
    assert found['scrolled'] == names
    ordered = [f'rig <{k}>' for k in range(70)]
    assert found['up'] == ordered[:ROWS]
    assert found['down'] == ordered[:-ROWS - 1:-1]
    assert found['filtered'] == ['rig <3>']
