"""The store and the task: atomic, known again, and on one core."""
import os
import shutil
import subprocess
import sys
import time

from fleet_by_hand import broken, PLANT, record
import numpy as np
import pytest
from trace_by_hand import result

from hydro_twin.errors import BagError
from hydro_twin.fleet import store
from hydro_twin.fleet.factors import rows_of
from hydro_twin.fleet.manifest import Task
from hydro_twin.fleet.task import command_of, factor_of, run, values_of
from hydro_twin.parallel import in_processes, on_one_core
from hydro_twin.plants import plant_named
from hydro_twin.recording.digest import source_of
from hydro_twin.recording.rig import rig_of
from hydro_twin.report.summary import summarise


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp('task')
    record(folder, 'bag', 1)
    return folder


def task(bag, **more):
    return Task(**{'rig': 'a', 'plant': PLANT, 'bags': (bag,), 'date': '', 'measured': True,
                   'config': None, 'constants': (), 'group': 'g', 'labels': (), **more})


def test_a_task_is_done_once(folder, tmp_path):
    """It knows the bag again by what it holds, wherever it lies, and nothing else."""
    first = run(task(folder / 'bag'), tmp_path, 0)
    place = tmp_path / 'results' / first.key
    assert {'report.html', 'report.json', 'model.yaml', 'result.json'} <= {
        path.name for path in place.iterdir()}
    assert [path.name for path in place.parent.iterdir()] == [first.key]
    written = {path: path.stat().st_mtime_ns for path in place.rglob('*')}
    shutil.copytree(folder / 'bag', tmp_path / 'moved')
    again = run(task(tmp_path / 'moved', rig='b'), tmp_path, 0)
    assert first.traced
    assert (again.traced, again.key, again.record) == (False, first.key, first.record)
    assert {path: path.stat().st_mtime_ns for path in place.rglob('*')} == written


def test_the_key_depends_on_all_that_goes_into_a_trace(folder, tmp_path, monkeypatch):
    rig = rig_of(plant_named('load_simulator'))
    bags = [source_of(folder / 'bag')]
    (tmp_path / 'other').write_text('x')
    config = tmp_path / 'config.yaml'
    config.write_text('/**: {ros__parameters: {sample_time: 0.004}}')
    keys = {store.key_of(bags, rig, 0), store.key_of(bags, rig, 1),
            store.key_of([*bags, source_of(tmp_path / 'other')], rig, 0),
            store.key_of(bags, rig_of(rig.plant, constants={'D_m': 3e-5}), 0),
            store.key_of(bags, rig_of(rig.plant, config), 0),
            store.key_of(bags, rig_of(plant_named('cylinder')), 0)}
    monkeypatch.setattr(store, 'version', lambda name: '99')
    assert len(keys | {store.key_of(bags, rig, 0)}) == 7
    monkeypatch.undo()
    assert store.key_of(bags, rig_of(rig.plant), 0) in keys


@pytest.mark.slow
def test_the_command_makes_the_same_trace(folder, tmp_path, monkeypatch):
    """The record is what the verb `trace` reports."""
    import json
    import shlex

    from hydro_twin.commands.main import main

    one = task(folder / 'bag', constants=())
    record_ = run(one, tmp_path, 3).record
    monkeypatch.chdir(tmp_path)
    assert main(shlex.split(command_of(one, 3))[1:]) == 0
    report = json.loads((tmp_path / 'out' / 'report.json').read_text('utf-8'))
    assert record_['says'] == report['says']
    known = {name: (p['value'], p['std_error'])
             for name, p in report['parameters']['after'].items() if p['std_error']}
    assert known
    # Where a search ends within its tolerance depends on rounding, and so on where arrays lie.
    assert {name: (one['value'], one['std_error'])
            for name, one in record_['estimates'].items()} == {
                name: pytest.approx(two, rel=1e-4) for name, two in known.items()}


def test_the_factor_has_the_standard_errors_of_the_estimates():
    """Of the combinations, too."""
    made = result('valve_servo', True)
    values = values_of(made, summarise(made))
    factor = factor_of(made, values)
    known = {one: value for one, value in values.items()
             if value['std_error'] and one in factor['names']}
    assert any(' / ' in one for one in known)
    assert any(': ' in one for one in known)
    names = factor['names']
    _, covariance = rows_of(factor, names, [False] * len(names)).solve()
    errors = dict(zip(names, np.sqrt(np.diag(covariance)), strict=True))
    for one, value in known.items():
        assert errors[one] == pytest.approx(value['std_error'], rel=1e-6)


def test_a_broken_bag_is_raised_and_samples_that_do_not_do_are_a_reason(folder, tmp_path):
    broken(tmp_path, 'bag')
    with pytest.raises(BagError, match='damaged'):
        run(task(tmp_path / 'bag'), tmp_path, 0)
    came = run(task(folder / 'bag', plant='load_simulator', constants=(('x', 1.0),)), tmp_path, 0)
    assert came.record is None
    assert 'has no constant x' in came.reason
    assert not list(tmp_path.glob('results/*'))


def test_a_result_is_there_whole_or_not_at_all(tmp_path):
    def fails(part):
        (part / 'report.html').write_text('half')
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        store.keep(tmp_path, 'key', fails)
    assert list((tmp_path / 'results').iterdir()) == []
    assert store.find(tmp_path, 'key') is None


def test_the_faster_of_two_is_kept(tmp_path):
    def slower(part):
        moved = store.RESULTS
        first = tmp_path / moved / 'key'
        first.mkdir()
        (first / store.RECORD).write_text('{"by": "faster"}')
        return {'by': 'slower'}

    assert store.keep(tmp_path, 'key', slower) == {'by': 'faster'}
    assert [path.name for path in (tmp_path / 'results').iterdir()] == ['key']


def test_what_a_killed_process_left_is_swept_and_no_other(tmp_path):
    """The process is one that is killed while it writes."""
    code = ('import os, signal, sys; from pathlib import Path\n'
            'from hydro_twin.fleet import store\n'
            'store.keep(Path(sys.argv[1]), "key", lambda part: os.kill(os.getpid(), 9))')
    subprocess.run([sys.executable, '-c', code, tmp_path], check=False)
    (left,) = (tmp_path / 'results').iterdir()
    _, key, thread, process, host = left.name.split('.', 4)
    mine = left.with_name(f'.{key}.{thread}.{os.getpid()}.{host}')
    elsewhere = left.with_name(f'.{key}.{thread}.{process}.elsewhere')
    mine.mkdir()
    elsewhere.mkdir()
    store.sweep(tmp_path)
    assert set((tmp_path / 'results').iterdir()) == {mine, elsewhere}


def pid(k):
    time.sleep(0.02)
    return os.getpid()


@pytest.mark.slow
def test_on_one_core_nothing_spreads(monkeypatch):
    """Not even where workers wait already, and though the work is worth it."""
    monkeypatch.setattr('hydro_twin.parallel.WORTH', 0.0)
    monkeypatch.setattr('hydro_twin.parallel._cores', lambda: 2)
    end = time.monotonic() + 60.0           # by which a worker has surely started
    while len(set(in_processes(pid, range(50)))) < 2:
        assert time.monotonic() < end
    with on_one_core():
        assert set(in_processes(pid, range(20))) == {os.getpid()}
