"""The documentation: what it says of the code is so, and its figures are those found."""
import importlib
import json
from pathlib import Path
import re
import shlex

import pytest

from hydro_twin.commands.main import main
from hydro_twin.effects import EFFECTS, sites
from hydro_twin.plants import PLANTS

ROOT = Path(__file__).resolve().parents[1]
PAGES = {path.name: path.read_text(encoding='utf-8') for path in (ROOT / 'docs').glob('*.md')}


def commands(page):
    """Collect what follows hydro-twin on the indented lines of a page."""
    return [shlex.split(line) for line in
            re.findall(r'^    hydro-twin (.*)$', PAGES[page], re.MULTILINE)]


def sections():
    """Split the catalogue: id -> text."""
    parts = re.split(r'^## (\w+)$', PAGES['effects.md'], flags=re.MULTILINE)[1:]
    return dict(zip(parts[::2], parts[1::2], strict=True))


def test_the_catalogue_has_every_effect_once():
    assert sorted(sections()) == sorted({effect.id for effect in EFFECTS})


@pytest.mark.parametrize('effect', EFFECTS, ids=lambda e: f'{e.id}-{e.kinds[0]}')
def test_the_catalogue_tells_ports_and_parameters(effect):
    text = sections()[effect.id]
    for plant in PLANTS.values():
        for port in set(sites(effect, plant)) & set(plant.ports):
            assert f'`{port.name}`' in text
    for parameter in effect.parameters:
        marks = ('*`', '`*') if parameter.refinement is not None else ('`', '`')
        assert f'{marks[0]}{parameter.name}{marks[1]}' in text
    for other in re.findall(r'^- \*\*Confused with\*\*:.*', text, re.MULTILINE):
        assert set(re.findall(r'`(\w+)`', other)) <= {e.id for e in EFFECTS}


def test_the_catalogue_names_the_ports():
    for plant in PLANTS.values():
        names = [port.name for port in plant.ports
                 if any(effect.fits(port) for effect in EFFECTS)]
        assert f'| `{plant.name}` | {", ".join(dict.fromkeys(names))} |' in PAGES['effects.md']


def test_the_numbers_of_the_verdict_are_the_codes():
    rows = re.findall(r'^\| `([\w.]+)\.([A-Z_]+)` \| ([\d.]+) \|', PAGES['tracing_method.md'],
                      re.MULTILINE)
    assert len(rows) > 10
    for module, name, value in rows:
        assert getattr(importlib.import_module(f'hydro_twin.{module}'), name) == float(value), name


@pytest.mark.slow
def test_a_plan_is_simulated_traced_and_fitted(tmp_path, monkeypatch):
    """The commands of docs/recording.md, in their order."""
    (tmp_path / 'out').mkdir()
    monkeypatch.chdir(tmp_path)
    for arguments in commands('recording.md'):
        assert main(arguments) == 0, arguments
    report = json.loads((tmp_path / 'out' / 'plan_report' / 'report.json').read_text('utf-8'))
    assert 'backlash' in {effect['id'] for effect in report['effects']}
    assert (tmp_path / 'out' / 'plan_linear.yaml').is_file()
