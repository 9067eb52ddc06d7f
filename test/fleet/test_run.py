"""Whole runs with real processes: what is killed, what goes on, and that engines agree."""
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
import contextlib
from datetime import datetime
import json
import multiprocessing
import os
from pathlib import Path
import signal
import subprocess
import sys
import threading
import time

from engine_work import kill_or_square
from fleet_by_hand import broken, manifest, PLANT, record
import pytest

from benchmarks.dask_cluster import cluster
from hydro_twin.errors import UserError
from hydro_twin.fleet import store, trace_fleet
from hydro_twin.fleet.engine import reason, work
from hydro_twin.fleet.run import _Teller
from hydro_twin.fleet.task import Outcome
from hydro_twin.plants import plant_named
from hydro_twin.recording.digest import source_of
from hydro_twin.recording.rig import rig_of

RIGS = 3
pytest.importorskip('pyarrow')


@pytest.fixture(scope='module')
def bags(tmp_path_factory):
    """Make a manifest of three rigs, and a fourth whose bag is broken."""
    folder = tmp_path_factory.mktemp('fleet')
    for k in range(RIGS):
        record(folder, f'bag_{k}', k)
    broken(folder, 'bag_broken')
    manifest(folder, [*(f'rig {k},{PLANT},bag_{k},2026-01-{k + 1:02d}' for k in range(RIGS)),
                      f'rig 3,{PLANT},bag_broken,2026-02'])
    return folder


def key_of(bag):
    return store.key_of([source_of(bag)], rig_of(plant_named(PLANT)), 0)


def command(bags, out, *more):
    """Start the verb as a user does, in a session of its own.

    It heeds Ctrl-C also where the tests were started in the background of a script, which hands
    on that it be ignored.
    """
    return subprocess.Popen(
        ['env', '--default-signal=INT', sys.executable, '-m', 'hydro_twin.commands.main', 'fleet',
         bags / 'fleet.csv', '-o', out, *(more or ('--workers', '1')), '--json'],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True)


def ended(process):
    """Wait for the verb; returns its object and what it said."""
    out, said = process.communicate(timeout=240)
    assert process.returncode == 0, said
    return json.loads(out), said


def results(out):
    """List the results that are whole."""
    return {path.name: path.stat().st_mtime_ns for path in (out / 'results').glob('[!.]*')}


def by_rig(fleet):
    return {rig['rig']: rig for rig in fleet['rigs']}


def periods(fleet):
    """Return the results of each rig, without their times."""
    return {name: [{**period, 'seconds': None} for period in rig['periods']]
            for name, rig in by_rig(json.loads(json.dumps(fleet))).items()}


def alike(fleet):
    """Leave out what depends on the time and the engine."""
    return {'groups': fleet['groups'], 'rigs': [
        {**rig, 'periods': periods(fleet)[rig['rig']]} for rig in fleet['rigs']]}


@pytest.fixture(scope='module')
def by_threads(bags, tmp_path_factory):
    """Trace with an executor of the standard library."""
    out = tmp_path_factory.mktemp('threads')
    said = []
    with ThreadPoolExecutor(1) as executor:
        made = trace_fleet(bags / 'fleet.csv', out, executor=executor, say=said.append)
    return out, made, said


def test_a_broken_bag_says_so_in_its_row_and_the_rest_is_there(bags, by_threads):
    out, made, said = by_threads
    rigs = by_rig(made)
    (problem,) = rigs['rig 3']['problems']
    assert 'bag_broken is damaged' in problem['reason']
    assert any('rig 3' in line and 'bag_broken is damaged' in line for line in said)
    assert made['traces'] == {'done': RIGS, 'traced_now': RIGS, 'failed': 1}
    for k in range(RIGS):
        assert (out / rigs[f'rig {k}']['report']).is_file()
    assert set(results(out)) == {key_of(bags / f'bag_{k}') for k in range(RIGS)}
    assert said[-1].startswith('4 of 4 done')


@pytest.mark.slow
def test_two_threads_with_the_same_bag_do_not_mind(bags, tmp_path):
    path = manifest(bags, [f'{name},{PLANT},bag_0,2026' for name in 'ab'], 'twice.csv')
    with ThreadPoolExecutor(2) as executor:
        made = trace_fleet(path, tmp_path, executor=executor)
    assert made['traces']['failed'] == 0
    assert len({rig['report'] for rig in made['rigs']}) == len(results(tmp_path)) == 1


def test_one_more_bag_is_one_more_trace(bags, by_threads):
    out, _, _ = by_threads
    before = results(out)
    more = bags / 'more'
    more.mkdir()
    record(more, 'bag_7', 7)
    path = manifest(bags, [f'rig {k},{PLANT},bag_{k},2026-01-{k + 1:02d}' for k in range(RIGS)]
                    + [f'rig 0,{PLANT},more/bag_7,2026-02'], 'more.csv')
    with ThreadPoolExecutor(1) as executor:
        again = trace_fleet(path, out, executor=executor)
    assert again['traces'] == {'done': RIGS + 1, 'traced_now': 1, 'failed': 0}
    assert {key: results(out)[key] for key in before} == before
    assert set(results(out)) - set(before) == {key_of(more / 'bag_7')}
    assert len(by_rig(again)['rig 0']['periods']) == 2


def test_a_pool_that_breaks_is_a_reason_for_what_it_had():
    with ProcessPoolExecutor(1, multiprocessing.get_context('spawn')) as pool:
        came = dict(work(kill_or_square, [2, 'raises', 'dies', 3], pool))
    assert came[0] == 4
    assert reason(came[1]) == 'ValueError: no square'
    assert reason(came[2]).startswith('BrokenProcessPool: ')
    assert sorted(came) == [0, 1, 2, 3]


def test_what_is_left_is_cancelled_where_the_caller_stops():
    class Never(Executor):
        """Begins nothing but the first."""

        def __init__(self):
            self.futures = []

        def submit(self, function, /, *arguments, **_):
            self.futures.append(Future())
            if len(self.futures) == 1:
                self.futures[0].set_result(function(*arguments))
            return self.futures[0] if len(self.futures) == 1 else self.futures[-1]

    engine = Never()
    outcomes = work(kill_or_square, [1, 2, 3], engine)
    assert next(outcomes) == (0, 1)
    outcomes.close()
    assert [future.cancelled() for future in engine.futures] == [False, True, True]


@pytest.mark.slow
@pytest.mark.parametrize('missing', ['distributed', 'pyarrow'])
def test_without_the_extra_one_line_says_what_to_install(bags, tmp_path, missing):
    code = (f'import sys; sys.modules[{missing!r}] = None\n'
            'from hydro_twin.commands.main import main\n'
            f'sys.exit(main(["fleet", {str(bags / "fleet.csv")!r}, "-o", {str(tmp_path)!r}]))')
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True,
                          check=False)
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].endswith(
        f"needs the module {missing}: install '.[fleet]' from the repository")
    assert 'Traceback' not in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_is_refused(bags, tmp_path):
    (tmp_path / 'file').write_text('')
    with ThreadPoolExecutor(1) as executor:
        for place in ('file', 'file/out'):
            with pytest.raises(UserError, match='file'):
                trace_fleet(bags / 'fleet.csv', tmp_path / place, executor=executor)
    assert [path.name for path in tmp_path.iterdir()] == ['file']


def test_the_help_does_not_import_the_engine():
    code = ('import sys\nfrom hydro_twin.commands.main import main\n'
            'try:\n    main(["fleet", "--help"])\nexcept SystemExit:\n    pass\n'
            'print(*sys.modules, file=sys.stderr)')
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, check=True)
    assert '--scheduler' in done.stdout
    assert not {'dask', 'distributed', 'pyarrow', 'numpy'} & set(done.stderr.split())


def wait_for_a_result(process, out):
    """Wait until a run has made a result, and is still at work."""
    while not results(out):
        assert process.poll() is None
        time.sleep(0.02)


@pytest.mark.slow
def test_a_run_that_is_killed_goes_on_where_it_was(bags, by_threads, tmp_path):
    """And what comes of it, by Dask, is what another engine makes."""
    pytest.importorskip('distributed')
    out = tmp_path / 'out'
    with command(bags, out) as first:
        wait_for_a_result(first, out)
        os.killpg(first.pid, signal.SIGKILL)
    done = results(out)
    assert len(done) < RIGS
    assert not (out / 'fleet.json').exists()
    made, said = ended(command(bags, out))
    assert {key: results(out)[key] for key in done} == done
    assert made['traces'] == {'done': RIGS, 'traced_now': RIGS - len(done), 'failed': 1}
    assert f'{len(done)} found done' in said
    assert 'dashboard: http://127.0.0.1:' in said
    assert not list((out / 'results').glob('.*'))
    assert alike(made) == alike(by_threads[1])


@pytest.mark.slow
def test_where_the_scheduler_is_killed_another_goes_on(bags, by_threads, tmp_path):
    pytest.importorskip('distributed')
    out = tmp_path / 'out'
    with (cluster(tmp_path, 1) as found,
          command(bags, out, '--scheduler', found.address) as first):
        wait_for_a_result(first, out)
        found.scheduler.kill()
        _, said = first.communicate(timeout=60)
    assert first.returncode == 2
    assert 'is the Dask scheduler still there?' in said.splitlines()[-1]
    assert 'Traceback' not in said
    done = results(out)
    assert 0 < len(done) < RIGS
    assert not (out / 'fleet.json').exists()
    with cluster(tmp_path, 1) as found:
        made, _ = ended(command(bags, out, '--scheduler', found.address))
    assert {key: results(out)[key] for key in done} == done
    assert made['traces'] == {'done': RIGS, 'traced_now': RIGS - len(done), 'failed': 1}
    assert alike(made) == alike(by_threads[1])


def none_left(session, patience=200):
    """Wait for the last process of a session; what follows up its end takes a moment."""
    for _ in range(patience):
        try:
            os.killpg(session, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.1)
    return False


@pytest.mark.slow
def test_ctrl_c_leaves_all_that_is_done(bags, tmp_path):
    pytest.importorskip('distributed')
    out = tmp_path / 'out'
    with command(bags, out) as process:
        wait_for_a_result(process, out)
        os.killpg(process.pid, signal.SIGINT)
        _, said = process.communicate(timeout=60)
    assert process.returncode == 130
    assert said.splitlines()[-1] == 'hydro-twin fleet: interrupted'
    assert 'Traceback' not in said
    assert results(out)
    for key in results(out):
        assert store.find(out, key)
    assert none_left(process.pid)


def kill_worker_of(key, out, stop, times, killed):
    """Kill -9 whoever writes the result of a key, so many times; the folder names the process."""
    while not stop.is_set() and len(killed) < times:
        for part in (out / 'results').glob(f'.{key}.*'):
            pid = int(part.name.split('.')[3])
            if pid not in killed:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
                    killed.append(pid)
        stop.wait(0.01)


@contextlib.contextmanager
def killing(bags, out, name, times):
    """Kill the worker that traces a bag, each time that one does."""
    stop, killed = threading.Event(), []
    thread = threading.Thread(target=kill_worker_of,
                              args=(key_of(bags / name), Path(out), stop, times, killed))
    thread.start()
    try:
        yield killed
    finally:
        stop.set()
        thread.join()


@pytest.mark.slow
def test_a_killed_worker_is_made_good_and_a_trace_that_kills_each_is_given_up(
        bags, by_threads, tmp_path):
    """One worker dies once, amid rig 0; each that traces rig 2 dies; the others do not mind.

    What comes of those that do not kill is what another engine makes of them.
    """
    pytest.importorskip('distributed')
    with (killing(bags, tmp_path, 'bag_0', 1) as once,
          killing(bags, tmp_path, 'bag_2', 1000) as always):
        made, said = ended(command(bags, tmp_path, '--workers', '2'))
    rigs = by_rig(made)
    assert len(once) == 1
    for rig in ('rig 0', 'rig 1'):
        assert periods(made)[rig] == periods(by_threads[1])[rig]
    assert len(always) >= 2
    (problem,) = rigs['rig 2']['problems']
    assert 'worker process died' in problem['reason']
    assert problem['reason'] in said
    assert made['traces'] == {'done': RIGS - 1, 'traced_now': RIGS - 1, 'failed': 2}
    assert 'Traceback' not in said
    assert not list((tmp_path / 'results').glob('.*'))


def test_the_end_is_estimated_from_what_was_traced(monkeypatch):
    """Not from what was found done: of four, one is found at once, and one traced in 10 s."""
    now = [100.0]
    monkeypatch.setattr('hydro_twin.fleet.run.monotonic', lambda: now[0])
    said = []
    teller = _Teller(4, said.append)
    teller.one(Outcome({}, 'a'))
    assert said == []
    now[0] += 10.0
    before = datetime.now().replace(microsecond=0)
    teller.one(Outcome({}, 'b', traced=True))
    line, _, end = said[0].partition(', ends about ')
    assert line == '2 of 4 done, 1 found done'
    left = datetime.strptime(f'{before.year} {end}', '%Y %d %b %H:%M:%S') - before
    assert 20.0 <= left.total_seconds() <= 25.0
