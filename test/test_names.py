"""Names in prose: what docstrings, comments and pages say of files and imports is so."""
import ast
from pathlib import Path
import re

import pytest

ROOT = Path(__file__).resolve().parents[1]
OWN = ('bags', 'benchmarks', 'config', 'docs', 'hydro_twin', 'launch', 'scripts', 'test')
SOURCES = sorted(path for folder in OWN for path in (ROOT / folder).rglob('*.py'))
PAGES = sorted([*ROOT.glob('*.md'), *(path for folder in OWN for kind in ('*.md', '*.yaml')
                                      for path in (ROOT / folder).rglob(kind))])
# A file of the project ends in .py or .md, or lies in one of its folders.
FILE = re.compile(r'(?<![\w/.*-])(?:[\w*$./-]+\.(?:py|md)'
                  rf'|(?:{"|".join(OWN)})/[\w*$./-]*[\w*/])(?![\w*/])')
MODULE = re.compile(r'\bhydro_twin(?:\.[a-z]\w*)+\b')
# Entry points, beside those of packages.
GROUPS = {'hydro_twin.effect_options', 'hydro_twin.methods', 'hydro_twin.verbs'}
LINK = re.compile(r'\]\(([^)#:]+)(?:#[^)]*)?\)')
EXAMPLES = {   # what docs/adding.md shows how to add
    'hydro_twin/effects/knee.py', 'hydro_twin/plants/accumulator.py', 'config/accumulator.yaml',
    'hydro_twin/predictors/decay.py', 'hydro_twin/commands/extent.py'}


def label(path):
    return str(path.relative_to(ROOT))


def prose(path):
    """Return a page, or the docstrings and comments of a module."""
    text = path.read_text(encoding='utf-8')
    if path.suffix != '.py':
        return text
    docstrings = [ast.get_docstring(node) or '' for node in ast.walk(ast.parse(text))
                  if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)]
    return '\n'.join([*docstrings, *re.findall(r'(?:^|\s)# .*$', text, re.MULTILINE)])


def is_there(name, path):
    """Look for a file as a reader would: from the root, in the package, beside the text."""
    pattern = re.sub(r'\b[A-Z]+\b(?!\.md)|\$\w+', '*', name).removeprefix('./')   # PLANT.yaml
    if any(True for folder in (ROOT, ROOT / 'hydro_twin', path.parent)
           for _ in folder.glob(pattern)):
        return True
    # A page may name a file that there is once by its name.
    return path.suffix == '.md' and '/' not in name and any(
        True for folder in OWN for _ in (ROOT / folder).rglob(name))


def is_module(name):
    """Whether a dotted name is a module or a package, or a name in one."""
    path = ROOT.joinpath(*name.split('.'))
    places = [path] if path.parent == ROOT / 'hydro_twin' else [path, path.parent]
    return any(place.is_dir() or place.with_suffix('.py').is_file() for place in places)


def wrong_names(path):
    """Collect the files, modules and links in the prose of a file that there are not."""
    text = prose(path)
    examples = EXAMPLES if label(path) == 'docs/adding.md' else set()
    links = LINK.findall(text) if path.suffix == '.md' else []
    return [*(name for name in FILE.findall(text)
              if name not in examples and not is_there(name, path)),
            *(name for name in MODULE.findall(text)
              if name not in GROUPS and not is_module(name)),
            *(link for link in links if not (path.parent / link).exists())]


def test_modules_of_tests_have_names_of_their_own():
    """Without packages, pytest imports them by their names alone."""
    names = [path.name for path in (ROOT / 'test').rglob('*.py') if path.name != 'conftest.py']
    assert sorted(names) == sorted(set(names))


def test_files_and_modules_named_exist():
    wrong = {label(path): names for path in (*SOURCES, *PAGES) if (names := wrong_names(path))}
    assert wrong == {}


def importers(module):
    """Collect the modules of the package that import another, anywhere in them."""
    found = set()
    for path in (ROOT / 'hydro_twin').rglob('*.py'):
        text = path.read_text(encoding='utf-8')
        for node in ast.walk(ast.parse(text)) if module in text else ():
            names = ([alias.name for alias in node.names] if isinstance(node, ast.Import) else
                     [node.module or ''] if isinstance(node, ast.ImportFrom) else [])
            if any(name.partition('.')[0] == module for name in names):
                found.add(str(path.relative_to(ROOT / 'hydro_twin')))
    return found


@pytest.mark.parametrize('module', ['rclpy', 'torch', 'distributed'])
def test_only_the_modules_named_import(module):
    """CONTRIBUTING says which: "Only ... import `module`"."""
    text = (ROOT / 'CONTRIBUTING.md').read_text(encoding='utf-8')
    (said,) = re.findall(rf'Only ((?:[^.;]|\.py)*?) imports? `{module}`', text)
    named, found = re.findall(r'`([\w/]+(?:\.py|/))`', said), importers(module)
    assert all(any(path.startswith(name) for path in found) for name in named)
    assert all(any(path.startswith(name) for name in named) for path in found)
    assert len(re.findall(rf'`{module}`', text)) == 1
