"""The command line: finds the verb and turns its result, or its error, into what a shell wants.

A verb is one module of `hydro_twin.commands`, with a `Verb` (see `hydro_twin.commands.verb`).
What goes wrong is raised: a `UserError` becomes one line on standard error and exit status 2.
Any other exception is a defect: one line too, which names a file for a report, and status 1.
"""
from __future__ import annotations

import argparse
from collections.abc import Sequence
import contextlib
import json
import os
import sys
from typing import NoReturn

from hydro_twin.as_json import as_json
from hydro_twin.blas import ENVIRONMENT
from hydro_twin.commands.registry import verb_named, verbs
from hydro_twin.commands.verb import Command, RosVerb, Verb
from hydro_twin.errors import UserError
from hydro_twin.stopping import listen

PROG = 'hydro-twin'
ROS = "source ROS 2 Jazzy, or install '.[ros]' from the repository"
FLEET = "install '.[fleet]' from the repository"
REMEDIES = {   # module that a plain install may lack -> where it comes from
    'dask': FLEET,
    'diagnostic_msgs': ROS,
    'distributed': FLEET,
    'pyarrow': FLEET,
    'rcl_interfaces': ROS,
    'rclpy': ROS,
    'torch': "install '.[learn]' from the repository",
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
    os.environ.update({**ENVIRONMENT, **os.environ})
    argv = list(sys.argv[1:] if arguments is None else arguments)
    verb = argv[0] if argv and not argv[0].startswith('-') else ''
    try:
        return _run(argv, verb_named(verb))
    except ModuleNotFoundError as error:
        remedy = REMEDIES.get((error.name or '').partition('.')[0], 'is the installation whole?')
        return _fail(verb, f'needs the module {error.name}: {remedy}', 2)
    except UserError as error:
        return _fail(verb, str(error), 2)
    except OSError as error:
        what = f'{error.filename}: {error.strerror}' if error.filename else str(error)
        return _fail(verb, what, 2)
    except MemoryError:
        return _fail(verb, 'not enough memory', 2)
    except KeyboardInterrupt:
        return _fail(verb, 'interrupted', 130)
    except Exception as error:
        return _fail(verb, f'a defect of this software ({type(error).__name__}: {error}); please '
                     f'report it, and attach {_crash_report(argv, error)}', 1)


def _run(argv: list[str], verb: Command | None) -> int:
    """Run a verb; where there is none, say which there are."""
    if isinstance(verb, RosVerb):
        if not {'-h', '--help'} & set(argv[1:]):
            listen()
            return verb.main(argv[1:])
        print(f'usage: {PROG} {verb.name} [--ros-args [-p NAME:=VALUE] [--params-file FILE] ...]'
              f'\n\n{verb.summary}\n\n{verb.help()}')
        return 0
    parser = _Parser(
        prog=PROG, description='A digital twin of electro-hydraulic actuators.',
        epilog=f"'{PROG} VERB --help' lists the arguments of a verb.")
    parser.add_argument('--version', action='store_true', help='print the version and exit')
    subparsers = parser.add_subparsers(dest='verb', metavar='VERB')
    for one in (verb,) if verb else verbs().values():
        subparsers.add_parser(one.name, help=one.summary,
                              description=f'{one.summary[0].upper()}{one.summary[1:]}.')
    if isinstance(verb, Verb):
        verb.add_arguments(subparsers.choices[verb.name])
        subparsers.choices[verb.name].add_argument(
            '--json', action='store_true', help='print one JSON object, and nothing else')
    args = parser.parse_args(argv)
    args.argv = argv
    if args.version:
        from importlib.metadata import version
        print(PROG, version('hydro_twin'))
        return 0
    if not isinstance(verb, Verb):
        parser.error('a VERB is needed')

    with contextlib.redirect_stdout(sys.stderr):
        result = verb.run(args)
    if args.json:
        print(json.dumps(as_json(result), allow_nan=False))
    else:
        from rich.console import Console
        verb.show(result, Console())
    return 0


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
