"""The documentation: what it says of the code is so, and its figures are those found."""
import importlib
import json
from pathlib import Path
import re
import shlex
import shutil

import pytest

from hydro_twin.commands.main import main
from hydro_twin.effects import EFFECTS, sites
from hydro_twin.plants import PLANTS

ROOT = Path(__file__).resolve().parents[1]
PAGES = {path.name: path.read_text(encoding='utf-8') for path in (ROOT / 'docs').glob('*.md')}


# Pages whose commands are all run, in their order.
RUN = ('tracing.md', 'recording.md')


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
        for port in sites(effect, plant):
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
    rows = re.findall(r'^\| `([\w.]+)\.([A-Z_]+)` \| ([\d.]+) \|', PAGES['tracing.md'],
                      re.MULTILINE)
    assert len(rows) > 10
    for module, name, value in rows:
        assert getattr(importlib.import_module(f'hydro_twin.{module}'), name) == float(value), name


@pytest.fixture(scope='module')
def copy(tmp_path_factory):
    """Make a folder with what a user has after cloning, as far as the commands need it."""
    folder = tmp_path_factory.mktemp('docs')
    shutil.copytree(ROOT / 'bags', folder / 'bags')
    (folder / 'out').mkdir()
    return folder


@pytest.fixture(scope='module')
def ran(copy):
    """Run the commands of the pages in their order; returns the folder in which they ran."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(copy)
        for page in RUN:
            for arguments in commands(page):
                assert main(arguments) == 0, arguments
    return copy


@pytest.mark.slow
def test_the_figures_of_the_example_are_those_found(ran):
    (arguments,) = commands('tracing.md')
    report = json.loads((ran / arguments[-1] / 'report.json').read_text(encoding='utf-8'))
    text = PAGES['tracing.md']
    assert f'> {report["says"]}' in text

    def row(start):
        line = next(line for line in text.splitlines() if line.startswith(f'| {start} '))
        found = [re.match(r'[\d.]+', cell.strip()) for cell in line.split('|')[2:]]
        return [float(number[0]) for number in found if number]

    for kind in ('free_run', 'one_step'):
        for part in ('test', 'train'):
            if found := [s for s in text.splitlines()
                         if s.startswith(f'| {kind.replace("_", " ")}, {part} ')]:
                assert row(found[0][2:].split(' [')[0]) == pytest.approx(
                    [report[when][kind][part] for when in ('before', 'after')], rel=0.02)
    assert row('noise, estimated') == pytest.approx([report['noise_floor']], rel=0.02)
    coulomb = report['effects'][0]['parameters']['coulomb']['value']
    assert row('Coulomb friction')[0] == pytest.approx(coulomb, rel=0.01)
    for name, tolerance in (('J', 0.1), ('B_m', 0.05), ('G', 0.02)):
        values = [report['parameters'][when][name]['value'] for when in ('before', 'after')]
        assert row(name)[:2] == pytest.approx(values, rel=tolerance)
    rival = report['effects'][0]['rivals'][0]
    distance = re.search(rf'next best explanation, an? {rival["id"]}, is (\d+) away', text)
    assert float(distance[1]) == pytest.approx(rival['delta_bic'], rel=0.02)
