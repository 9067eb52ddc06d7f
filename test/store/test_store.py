"""The store: whole after any kill, aliases, descent, and its verbs."""
from itertools import pairwise
import json
from pathlib import Path
import re
import subprocess
import sys

import pytest
from store_models import model, write
import yaml

from hydro_twin.commands.main import main
from hydro_twin.model import document
from hydro_twin.store.store import Store
from hydro_twin.store.version import StoreError

FRICTION = [('friction', 'motor', {'coulomb': (10.0, 0.1)})]


@pytest.mark.slow
def test_a_store_reads_whole_after_kills_at_random_moments(tmp_path):
    path = write(tmp_path / 'model.yaml')
    done = subprocess.run(
        [sys.executable, str(Path(__file__).with_name('killed_writer.py')),
         str(tmp_path / 'store'), str(path), '15'], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    read = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(read) >= 15
    for (names, _), (later, _) in pairwise(read):
        assert later[:len(names)] == names        # nothing that was there is lost
    store = Store.opened(tmp_path / 'store')
    assert len(store.versions()) == len(read[-1][0]) > 10
    for version in store.versions():
        assert document(version.model()) == document(model())
    # The next writer goes on, and takes away what the killed ones left.
    store.enter(path, 'a test')
    left = [one for one in (tmp_path / 'store').rglob('.*')
            if one.name not in ('.lock', '.gitignore')]
    assert not left
    champion = store.champion
    assert champion is not None
    promoted = store.promote(store.versions()[-1].name, 'a test')
    assert store.predecessor().name == champion.name
    assert store.roll_back('a test').name == champion.name == promoted.parent


def test_what_changed_says_since_when(tmp_path):
    store = Store(tmp_path / 'store')
    first = store.promote(store.enter(write(tmp_path / 'a.yaml', [
        ('backlash', 'coupling', {'gap': (0.9e-3, 1e-5)})]), 'me').name, 'me')
    path = first.folder / 'decision.json'
    record = json.loads(path.read_text())
    record['decisions'][0]['when'] = '2026-05-03T10:00:00.000000+00:00'
    path.write_text(json.dumps(record))
    made = store.enter(write(tmp_path / 'b.yaml', [
        ('backlash', 'coupling', {'gap': (1.6e-3, 1e-5)})]), 'me')
    assert made.record['changed'] == (
        'coupling backlash grew from 0.9 to 1.6 mrad since 3 May 2026')


def test_descent_aliases_and_decisions(tmp_path):
    store = Store(tmp_path / 'store')
    first = store.promote(store.enter(write(tmp_path / 'a.yaml'), 'me').name, 'me')
    second = store.enter(write(tmp_path / 'b.yaml', FRICTION), 'keep', as_challenger=True,
                         bag={'path': 'x', 'sha256': '0'})
    assert (first.parent, second.parent, second.name) == (None, '0001', '0002')
    assert (tmp_path / 'store' / 'champion').read_text() == '0001\n'
    assert store.challenger.name == '0002'
    store.promote('challenger', 'auto', {'e_value': 25.0})
    assert (store.champion.name, store.challenger) == ('0002', None)
    assert store.predecessor().name == '0001'
    with pytest.raises(StoreError, match='0002 is the champion already'):
        store.promote('2', 'me')
    assert store.roll_back('me', why='a try').name == '0001'
    with pytest.raises(StoreError, match='first champion'):
        store.roll_back('me')
    store.promote('0002', 'me')
    assert store.roll_back('me').name == '0001'
    third = store.enter(write(tmp_path / 'c.yaml'), 'keep', as_challenger=True)
    store.decide(third.name, 'discarded', 'auto', why='no better')
    assert store.challenger is None
    whats = [d['what'] for d in store.version('0002').decisions]
    assert whats == ['entered', 'promoted', 'rolled back', 'promoted', 'rolled back']
    assert store.version('2').decisions[1]['evidence'] == {'e_value': 25.0}


def test_an_alias_set_by_hand_counts_and_is_noted(tmp_path):
    store = Store(tmp_path)
    for name in ('a', 'b', 'c'):
        store.promote(store.enter(write(tmp_path / f'{name}.yaml'), 'me').name, 'me')
    (tmp_path / 'champion').write_text('0001\n')
    assert store.champion.name == '0001'
    store.promote('0002', 'me')
    assert store.champion.name == '0002'
    assert store.version('0003').decisions[-1]['what'] == 'interrupted'
    assert store.roll_back('me').name == '0001'
    (tmp_path / 'champion').write_text('nonsense\n')
    with pytest.raises(StoreError, match=r'champion.*is no version'):
        _ = store.champion


def test_what_does_not_belong_is_refused(tmp_path):
    store = Store(tmp_path / 'store')
    store.promote(store.enter(write(tmp_path / 'a.yaml'), 'me').name, 'me')
    from hydro_twin.plants import plant_named
    other = write(tmp_path / 'b.yaml', plant=plant_named('cylinder'))
    with pytest.raises(StoreError, match='a model of cylinder'):
        store.enter(other, 'me')
    assert [version.name for version in store.versions()] == ['0001']
    (tmp_path / 'store' / 'models' / '0001' / 'decision.json').write_text('{')
    with pytest.raises(StoreError, match=r'decision\.json: damaged'):
        store.versions()


@pytest.mark.parametrize(('change', 'what'), [
    ({'decisions': []}, 'decisions'), ({'decisions': ['entered']}, 'TypeError'),
    ({'decisions': [{'what': 'entered', 'by': 'me'}]}, "'when'"),
    ({'decisions': [{'what': 'entered', 'when': 'yesterday', 'by': 'me'}]}, 'yesterday'),
    ({'decisions': [{'what': 'entered', 'when': '2026-05-03T10:00:00', 'by': None}]}, 'by'),
    ({'decisions': [{'what': 'rolled back', 'when': '2026-05-03T10:00:00', 'by': 'me'}]}, "'to'"),
    ({'changed': None}, 'changed')])
def test_a_record_that_lacks_what_its_readers_need_is_damaged(tmp_path, capsys, change, what):
    store = Store(tmp_path / 'store')
    version = store.enter(write(tmp_path / 'a.yaml'), 'me')
    (version.folder / 'decision.json').write_text(json.dumps({**version.record, **change}))
    with pytest.raises(StoreError, match=r'decision\.json: damaged') as raised:
        store.versions()
    assert what in str(raised.value)
    assert main(['history', str(store.path)]) == 2
    assert 'damaged' in capsys.readouterr().err


def test_the_verbs(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write(tmp_path / 'a.yaml', J=(0.03, 0.001))
    write(tmp_path / 'b.yaml', FRICTION, J=(0.04, 0.001))
    assert main(['history', 'store']) == 2
    assert 'no store' in capsys.readouterr().err
    assert main(['promote', 'store', '--model', 'a.yaml']) == 0
    assert main(['promote', 'store', '--model', 'b.yaml']) == 0
    capsys.readouterr()
    assert main(['history', 'store', '--html', 'page.html', '--json']) == 0
    one, two = json.loads(capsys.readouterr().out)['versions']
    assert (one['version'], one['alias'], two['alias'], two['parent']) == (
        '0001', '', 'champion', '0001')
    assert 'motor friction' in two['changed']
    assert 'J grew from 0.03 to 0.04' in two['changed']
    page = (tmp_path / 'page.html').read_text('utf-8')
    data = json.loads(re.search(r'<script type="application/json" id="data">(.*?)</script>', page,
                                re.DOTALL)[1])
    titles = re.findall(r'<h3>(.*?)</h3>', page)
    (course,) = data[f'course_{titles.index("J")}']['views'][0]['charts']
    points = next(curve for curve in course['curves'] if curve['kind'] == 'points')
    assert points['y'] == [0.03, 0.04]
    assert points['error'] == [0.002, 0.002]
    assert 'motor friction' in ' '.join(titles)
    assert main(['rollback', 'store', '--json']) == 0
    assert json.loads(capsys.readouterr().out)['champion'] == '0001'
    assert main(['rollback', 'store']) == 2
    assert main(['promote', 'store', '7']) == 2
    assert 'no version 7; there are: 0001, 0002' in capsys.readouterr().err
    assert yaml.safe_load((tmp_path / 'store' / 'models' / '0002' / 'model.yaml').read_text())
