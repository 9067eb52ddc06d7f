"""The packages import each other as docs/architecture.md says, and no others."""
import ast
from pathlib import Path
import re
import subprocess
import sys

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / 'hydro_twin'
VALUES = ('api', 'model', 'result', 'schema')     # modules at the top that stand for a layer
ROW = re.compile(r'^\| (\d+) \| `(\w+)` \|(.*)\|$', re.MULTILINE)


def of(module):
    """Name the package of a dotted module name; those at the top hold only themselves."""
    name = module.split('.')[1] if module.count('.') else ''
    return name if (PACKAGE / name).is_dir() or name in VALUES else ''


def imported(path):
    """Collect what a file imports when it runs: not what it needs for its types only."""
    tree = ast.parse(path.read_text(encoding='utf-8'))
    typing = {id(node) for block in ast.walk(tree)
              if isinstance(block, ast.If) and getattr(block.test, 'id', '') == 'TYPE_CHECKING'
              for node in ast.walk(block)}
    return {of(node.module) for node in ast.walk(tree)
            if isinstance(node, ast.ImportFrom) and id(node) not in typing
            and (node.module or '').startswith('hydro_twin')}


def test_the_packages_import_each_other_as_the_page_says():
    page = (ROOT / 'docs' / 'architecture.md').read_text(encoding='utf-8')
    layer, said, upward = {}, {}, set()
    for level, package, imports in ROW.findall(page):
        down, _, up = imports.partition('**upward: ')
        climbs = set(re.findall(r'\w+', up))
        layer[package] = int(level)
        said[package] = climbs if 'type checking' in down else climbs | set(
            re.findall(r'\w+', down))
        upward |= {(package, name) for name in climbs}
    found = {package: set() for package in said}
    for path in PACKAGE.rglob('*.py'):
        here = path.relative_to(PACKAGE).parts[0].removesuffix('.py')
        if here in found:
            found[here] |= imported(path) - {here, ''}
    assert found == said
    climbing = {(here, there) for here, names in found.items() for there in names
                if layer[there] >= layer[here]}
    assert climbing == upward


def test_report_only_draws():
    """It sees results and models, and nothing that fits or judges one, even indirectly."""
    code = ('import importlib, pkgutil, sys, hydro_twin.report as report\n'
            'for module in pkgutil.iter_modules(report.__path__):\n'
            "    importlib.import_module(f'hydro_twin.report.{module.name}')\n"
            "print(*(name for name in sys.modules if name.startswith('hydro_twin.')))")
    loaded = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True,
                            check=True).stdout.split()
    packages = {of(name) for name in loaded}
    assert packages >= {'report', 'result', 'model'}
    assert not packages & {'fitting', 'inference', 'simulation', 'live', 'commands', 'studies'}
