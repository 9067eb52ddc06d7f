"""Tests of what all verbs share: exit statuses, one line an error, clean JSON, a quick start."""
import json
from pathlib import Path
import subprocess
import sys
import tempfile

import numpy as np
import pytest

from hydro_twin.as_json import as_json
from hydro_twin.commands import main as command_line
from hydro_twin.commands.main import main
from hydro_twin.commands.registry import verbs
from hydro_twin.commands.verb import Verb
from hydro_twin.errors import UserError


@pytest.fixture
def verb(monkeypatch):
    """Let a function stand in for `replay`."""
    def put(run):
        monkeypatch.setattr(command_line, 'verb_named', {'replay': Verb(
            'replay', 'do what a test wants', lambda parser: parser.add_argument('bag'), run,
            lambda result, console: console.print('for a person', result['rms']))}.get)
    return put


def fail(error):
    def run(args):
        raise error
    return run


def test_json_is_all_of_standard_output(verb, capsys):
    def run(args):
        print('a library talks')
        return {'bag': Path(args.bag), 'rms': np.float64('nan'), 'n': np.int64(3),
                'column': np.array([1.0, np.inf]), 'nested': [{'x': float('-inf')}, None, True]}
    verb(run)
    assert main(['replay', 'a/bag', '--json']) == 0
    out, err = capsys.readouterr()
    assert json.loads(out) == {'bag': 'a/bag', 'rms': None, 'n': 3, 'column': [1.0, None],
                               'nested': [{'x': None}, None, True]}
    assert out.count('\n') == 1
    assert err == 'a library talks\n'


def test_without_json_a_person_reads(verb, capsys):
    verb(lambda args: {'rms': 2.5})
    assert main(['replay', 'bag']) == 0
    assert capsys.readouterr() == ('for a person 2.5\n', '')


@pytest.mark.parametrize(('error', 'status', 'line'), [
    (UserError('bag x holds\n nothing'), 2, 'hydro-twin replay: bag x holds nothing\n'),
    (FileNotFoundError(2, 'No such file or directory', 'x'), 2,
     'hydro-twin replay: x: No such file or directory\n'),
    (ModuleNotFoundError("No module named 'torch'", name='torch'), 2,
     "hydro-twin replay: needs the module torch: install '.[learn]' from the repository\n"),
    (MemoryError(), 2, 'hydro-twin replay: not enough memory\n'),
    (KeyboardInterrupt(), 130, 'hydro-twin replay: interrupted\n'),
])
def test_errors_are_one_line(verb, capsys, error, status, line):
    verb(fail(error))
    assert main(['replay', 'bag', '--json']) == status
    assert capsys.readouterr() == ('', line)


def test_a_defect_is_one_line_that_names_a_file_to_attach(verb, capsys, tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, 'tempdir', str(tmp_path))
    verb(fail(ZeroDivisionError('of a\nlaw')))
    assert main(['replay', 'my bag', '--json']) == 1
    out, err = capsys.readouterr()
    (file,) = tmp_path.iterdir()
    assert out == ''
    assert err == ('hydro-twin replay: a defect of this software (ZeroDivisionError: of a law); '
                   f'please report it, and attach {file}\n')
    report = file.read_text()
    assert report.startswith("hydro-twin replay 'my bag' --json\n")
    assert f'numpy {np.__version__}\n' in report
    assert 'in run\n    raise error\n' in report
    assert report.endswith('ZeroDivisionError: of a\nlaw\n')


@pytest.mark.parametrize('arguments', [
    [], ['replya', 'bag'], ['replay'], ['replay', 'bag', '--no-such-option'],
])
def test_wrong_arguments_are_one_line(verb, capsys, arguments):
    verb(lambda args: {})
    with pytest.raises(SystemExit) as exit_:
        main(arguments)
    assert exit_.value.code == 2
    out, err = capsys.readouterr()
    assert out == ''
    assert err.startswith('hydro-twin')
    assert err.count('\n') == 1


def test_json_leaves_whole_numbers_and_truth_alone():
    assert as_json({1: (True, 2, 'x')}) == {'1': [True, 2, 'x']}
    assert as_json(np.bool_(True)) is True


@pytest.mark.parametrize('verb', verbs())
def test_help_loads_nothing_heavy(verb):
    """The command line answers in 0.3 s only as long as no verb imports more than it needs."""
    code = (
        'import sys\n'
        'from hydro_twin.commands.main import main\n'
        'try:\n'
        f'    main([{verb!r}, "--help"])\n'
        'except SystemExit:\n'
        '    pass\n'
        'heavy = {"numpy", "scipy", "numba", "torch", "rclpy", "rosbags", "rich", "matplotlib"}\n'
        'sys.exit(" ".join(heavy & set(sys.modules)) or 0)\n'
    )
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, '')
    assert 'usage: hydro-twin ' + verb in done.stdout
