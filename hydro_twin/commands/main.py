"""The command line: finds the verb and turns its result, or its error, into what a shell wants.

A verb is one module of `hydro_twin.commands`, with three functions:

    add_arguments(parser)    adds the verb's own arguments to an argparse parser. `--json` is
                             added here, for every verb. The module imports nothing heavy at its
                             top (no numpy, scipy, numba, rosbags, rich): that belongs in `run`.
    run(args) -> dict        does the work and returns the object that `--json` prints. It may hold
                             numpy scalars and arrays, paths and NaN (printed as null). It prints
                             nothing; progress goes to standard error (`common.progress`).
    show(result, console)    prints the same object for a person, on a `rich.console.Console`.

What goes wrong is raised: a `UserError` becomes one line on standard error and exit status 2.
Any other exception is a defect: one line too, which names a file for a report, and status 1.
`node` is not such a verb: `hydro_twin.ros.spin.main(arguments)` gets its arguments untouched.
"""
from __future__ import annotations

import argparse
from collections.abc import Sequence
import contextlib
import importlib
import json
import math
import os
import sys
from typing import NoReturn

from hydro_twin.errors import UserError

PROG = 'hydro-twin'
VERBS = {   # verb -> its module, what it does
    'node': ('', 'the live twin, a ROS 2 node (takes ROS arguments)'),
    'replay': ('replay', 'run a model over a recorded bag, or play the bag into ROS'),
    'refit': ('refit', 'fit a model to recorded bags'),
    'trace': ('trace', 'find the physical effect that a model lacks, add it, show the gain'),
    'simulate': ('simulate', 'make a recording from the physics'),
    'import': ('import_', 'make a bag of CSV or MAT tables'),
    'compare': ('compare', 'compare predictors and methods over repeated runs'),
    'identify': ('identify', 'identify a turbine valve servo as published, and by least squares'),
    'frequency-control': ('frequency_control', ('simulate primary frequency control with a linear '
                          'and a nonlinear valve servo')),
}
ROS = "source ROS 2 Jazzy, or install 'hydro_twin[ros]'"
REMEDIES = {   # module that a plain install may lack -> where it comes from
    'diagnostic_msgs': ROS,
    'rcl_interfaces': ROS,
    'rclpy': ROS,
    'torch': "install 'hydro_twin[learn]'",
}


class _Parser(argparse.ArgumentParser):
    """A parser that complains on one line."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {message}; '{self.prog} --help' tells more\n")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one verb.

    Args:
        arguments: what follows the program's name; by default that of this process.

    Returns:
        The exit status: 0, 2 after an error of the user's, 130 when interrupted, 1 after any
        other error, which is a defect of ours.
    """
    # The matrices here are small: threads of BLAS would cost more than they give.
    os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')
    argv = list(sys.argv[1:] if arguments is None else arguments)
    verb = argv[0] if argv and argv[0] in VERBS else ''
    try:
        return _node(argv[1:]) if verb == 'node' else _run(verb, argv)
    except ModuleNotFoundError as error:
        remedy = REMEDIES.get((error.name or '').partition('.')[0], 'is the installation whole?')
        return _fail(verb, f'needs the module {error.name}: {remedy}', 2)
    except UserError as error:
        return _fail(verb, str(error), 2)
    except OSError as error:
        what = f'{error.filename}: {error.strerror}' if error.filename else str(error)
        return _fail(verb, what, 2)
    except KeyboardInterrupt:
        return _fail(verb, 'interrupted', 130)
    except Exception as error:
        return _fail(verb, f'a defect of this software ({type(error).__name__}: {error}); please '
                     f'report it, and attach {_crash_report(argv, error)}', 1)


def _run(verb: str, argv: list[str]) -> int:
    """Run a verb whose module follows the contract above."""
    parser = _Parser(
        prog=PROG, description='A digital twin of electro-hydraulic actuators.',
        epilog=f"'{PROG} VERB --help' tells more.")
    parser.add_argument('--version', action='store_true', help='print the version and exit')
    verbs = parser.add_subparsers(dest='verb', metavar='VERB')
    for name, (_, summary) in VERBS.items():
        verbs.add_parser(name, help=summary, description=f'{summary[0].upper()}{summary[1:]}.')
    if verb:
        module = importlib.import_module(f'hydro_twin.commands.{VERBS[verb][0]}')
        module.add_arguments(verbs.choices[verb])
        verbs.choices[verb].add_argument(
            '--json', action='store_true', help='print one JSON object, and nothing else')
    args = parser.parse_args(argv)
    if args.version:
        from importlib.metadata import version
        print(PROG, version('hydro_twin'))
        return 0
    if not verb:
        parser.error('a VERB is needed')

    with contextlib.redirect_stdout(sys.stderr):
        result = module.run(args)
    if args.json:
        print(json.dumps(plain(result), allow_nan=False))
    else:
        from rich.console import Console
        module.show(result, Console())
    return 0


def _node(arguments: list[str]) -> int:
    """Hand over to the ROS node."""
    if {'-h', '--help'} & set(arguments):
        from hydro_twin.live.settings import overview
        print(f'usage: {PROG} node [--ros-args [-p NAME:=VALUE] [--params-file FILE] ...]\n\n'
              f'{VERBS["node"][1]}\n\nparameters:\n{overview()}')
        return 0
    from hydro_twin.ros.spin import main as spin
    return spin(arguments)


def plain(value: object) -> object:
    """Turn a verb's result into what JSON can say; a number that is not finite becomes None."""
    match value:
        case None | bool() | int() | str():
            return value
        case float():
            return float(value) if math.isfinite(value) else None
        case dict():
            return {str(key): plain(item) for key, item in value.items()}
        case list() | tuple():
            return [plain(item) for item in value]
        case _ if hasattr(value, 'tolist'):   # numpy, without importing it
            return plain(value.tolist())
    return str(value)


def _crash_report(argv: Sequence[str], error: Exception) -> str:
    """Write down what it takes to look into a defect; returns the path."""
    from importlib.metadata import PackageNotFoundError, version
    import platform
    import shlex
    import tempfile
    import traceback

    lines = [f'{PROG} {shlex.join(argv)}', f'python {platform.python_version()}',
             platform.platform()]
    for name in ('hydro_twin', 'numpy', 'scipy', 'numba', 'rosbags', 'torch'):
        with contextlib.suppress(PackageNotFoundError):
            lines.append(f'{name} {version(name)}')
    with tempfile.NamedTemporaryFile('w', prefix='hydro_twin_', suffix='.txt', delete=False,
                                     encoding='utf-8') as file:
        file.write('\n'.join([*lines, '', ''.join(traceback.format_exception(error))]))
    return file.name


def _fail(verb: str, message: str, status: int) -> int:
    """Say what went wrong, on one line."""
    print(f'{PROG} {verb}'.rstrip() + ': ' + ' '.join(message.split()), file=sys.stderr)
    return status


if __name__ == '__main__':
    sys.exit(main())
