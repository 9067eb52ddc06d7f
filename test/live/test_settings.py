"""Tests of the node's own parameters: one list for the node, its help and the pages."""
from pathlib import Path
import re

import pytest

from hydro_twin.commands.main import main
from hydro_twin.live.settings import SETTINGS
from hydro_twin.predictors.predictor import MODES, OBSERVER

ROOT = Path(__file__).resolve().parents[2]


def setting(name):
    return next(s for s in SETTINGS if s.name == name)


def test_help_lists_every_parameter_with_its_default(capsys):
    assert main(['node', '--help']) == 0
    said = ' '.join(capsys.readouterr().out.split())
    for s in SETTINGS:
        assert f' {s.name} {s.description}' in said
        if s.default not in ('', ('',)):
            assert f'(default: {str(s.default).lower()})' in said
    assert 'signals.SIGNAL.' in said


@pytest.mark.parametrize('page', ['README.md', 'docs/live.md'])
def test_the_pages_list_the_same_parameters(page):
    rows = re.findall(r'^\| `(\w+)` \|([^|]*)\|', (ROOT / page).read_text('utf-8'), re.MULTILINE)
    rows = {name: default.strip() for name, default in rows}
    for s in SETTINGS:
        expected = '' if s.default in ('', ('',)) else str(s.default).lower()
        assert rows[s.name].strip('`').removesuffix(' s') == expected


def test_modes_are_those_of_predictors():
    assert setting('mode').choices == (*MODES, OBSERVER)


@pytest.mark.parametrize(('name', 'value', 'good'), [
    ('wait', 1, True), ('wait', 0.0, True), ('wait', 10.0, True), ('wait', 11, False),
    ('wait', True, False), ('wait', '1', False), ('wait', float('nan'), False),
    ('mode', 'free_run', True), ('mode', 'two_step', False), ('model', 'any', True)])
def test_what_a_parameter_may_be(name, value, good):
    assert (setting(name).objection(value) == '') is good
