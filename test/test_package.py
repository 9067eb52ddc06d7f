"""Tests of the package's own description: manifests that agree, names that harm nobody."""
import ast
import importlib
from importlib.metadata import distribution, entry_points, requires, version
import os
from pathlib import Path
import re
import shutil
import subprocess
import sys
from xml.etree import ElementTree as ET

import yaml

from hydro_twin.commands.registry import verbs
from hydro_twin.share import share_folder

ROOT = Path(__file__).resolve().parents[1]
MANIFEST = ET.parse(ROOT / 'package.xml').getroot()
KEYS = {   # name of the distribution -> rosdep key, where there is one
    'jinja2': 'python3-jinja2',
    'llvmlite': 'python3-numba',    # which needs it
    'matplotlib': 'python3-matplotlib',
    'msgspec': None,
    'numba': 'python3-numba',
    'numpy': 'python3-numpy',
    'pyyaml': 'python3-yaml',
    'rich': 'python3-rich',
    'rosbags': 'python3-rosbags-pip',
    'safetensors': None,
    'scipy': 'python3-scipy',
    'threadpoolctl': None,
}
ROS = {'rclpy', 'builtin_interfaces', 'diagnostic_msgs', 'lifecycle_msgs', 'rcl_interfaces',
       'rosgraph_msgs', 'sensor_msgs', 'std_msgs', 'std_srvs', 'ament_index_python', 'launch',
       'launch_ros'}


def manifest(tag):
    return {element.text for element in MANIFEST.iter(tag)}


def imported(*folders):
    """Collect the top-level names of all that the code imports, wherever it does."""
    names = set()
    for path in (path for folder in folders for path in (ROOT / folder).rglob('*.py')):
        for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
            if isinstance(node, ast.Import):
                names |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                names.add(node.module or '')
    return {name.partition('.')[0] for name in names}


def test_manifests_agree():
    assert manifest('name') == {'hydro_twin'}
    assert manifest('version') == {version('hydro_twin')}
    assert manifest('license') == {'Apache-2.0'}
    assert manifest('build_type') == {'ament_python'}


def test_every_dependency_is_a_rosdep_key():
    needed = {re.split(r'[^\w-]', line)[0].lower() for line in requires('hydro_twin')
              if 'extra ==' not in line}
    assert {KEYS[name] for name in needed} - {None} <= manifest('exec_depend')


def test_every_ros_package_used_is_a_dependency():
    assert imported('hydro_twin', 'launch') & ROS <= manifest('exec_depend')


def test_every_library_used_is_a_dependency():
    modules = {'yaml': 'pyyaml'}
    foreign = imported('hydro_twin') - set(sys.stdlib_module_names) - ROS
    assert {modules.get(name, name) for name in foreign} <= {
        *KEYS, 'hydro_twin', 'torch', 'dask', 'distributed', 'pyarrow'}


def test_nothing_imports_the_studies():
    """They register what they add."""
    package = ROOT / 'hydro_twin'
    for path in package.rglob('*.py'):
        if path.relative_to(package).parts[0] != 'studies':
            assert 'hydro_twin.studies' not in path.read_text('utf-8'), path


def test_what_is_registered_is_what_the_metadata_says():
    """Where this fails, the environment was made of an older setup.py: install it again."""
    said = (ROOT / 'setup.py').read_text('utf-8')
    for group in ('hydro_twin.verbs', 'hydro_twin.methods'):
        entries = entry_points(group=group)
        assert entries.names
        for entry in entries:
            assert entry.load().name == entry.name
            assert entry.module.removeprefix('hydro_twin.studies.')[4:] in said


def test_a_verb_that_is_added_to_the_folder_is_there(tmp_path):
    """A file is all that it takes; the help and the call know it."""
    verb = ROOT / 'hydro_twin' / 'commands' / 'simulate.py'
    shutil.copytree(ROOT / 'hydro_twin', tmp_path / 'hydro_twin',
                    ignore=shutil.ignore_patterns('__pycache__'))
    (tmp_path / 'hydro_twin' / 'commands' / 'copied.py').write_text(
        verb.read_text('utf-8').replace("Verb('simulate'", "Verb('copied'"), 'utf-8')
    for arguments, says in (['--help'], 'copied'), (['copied', '--help'], 'hydro-twin copied'):
        done = subprocess.run(
            [sys.executable, '-m', 'hydro_twin.commands.main', *arguments], text=True,
            capture_output=True, check=True, cwd=tmp_path,
            env={**os.environ, 'PYTHONPATH': f'{tmp_path}:{ROOT}'})
        assert says in done.stdout


def test_every_folder_of_modules_is_installed():
    assert {path.parent for path in (ROOT / 'hydro_twin').rglob('*.py')} == {
        path.parent for path in (ROOT / 'hydro_twin').rglob('__init__.py')}


def test_the_node_says_where_ros_comes_from():
    code = (f'import sys; sys.modules.update(dict.fromkeys({sorted(ROS)}))\n'
            "from hydro_twin.commands.main import main; sys.exit(main(['node']))")
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True,
                          check=False)
    assert done.returncode == 2
    assert done.stderr.endswith("source ROS 2 Jazzy, or install '.[ros]' from the repository\n")
    assert done.stderr.count('\n') == 1


def test_a_plain_install_has_one_command():
    """`node` and `import` in the PATH would stand before Node.js and ImageMagick."""
    scripts = [entry.name for entry in distribution('hydro_twin').entry_points
               if entry.group == 'console_scripts']
    assert scripts == ['hydro-twin']


def test_every_verb_is_an_executable_of_the_ros_package():
    scripts = {path.name for path in (ROOT / 'scripts').iterdir() if path.is_symlink()}
    assert scripts == set(verbs())
    assert all(os.access(ROOT / 'scripts' / verb, os.X_OK) for verb in scripts)


def test_an_executable_is_its_verb():
    done = subprocess.run([sys.executable, ROOT / 'scripts' / 'node', '--help'],
                          capture_output=True, text=True, check=True)
    assert done.stdout.startswith('usage: hydro-twin node')


def test_what_comes_along_is_found():
    assert share_folder() == ROOT
    assert (share_folder() / 'config').is_dir()


def test_a_library_is_bounded_where_its_inside_is_used():
    """`rosbags` opens what its packages list in __all__; the rest may change with any version."""
    inside = set()
    for path in (ROOT / 'hydro_twin').rglob('*.py'):
        for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
            if isinstance(node, ast.ImportFrom) and (node.module or '').startswith('rosbags'):
                public = getattr(importlib.import_module(node.module), '__all__', ())
                inside |= {f'{node.module}.{name.name}' for name in node.names
                           if name.name not in public}
    qos = {f'rosbags.interfaces.Qos{part}' for part in ('', 'Durability', 'History', 'Liveliness',
                                                        'Reliability', 'Time')}
    assert inside - qos == {
        'rosbags.interfaces.Nodetype', 'rosbags.rosbag2.storage_mcap.decompress',
        'rosbags.typesys.store.Typestore'}   # the latter as a type only
    (spec,) = re.findall(r"'rosbags([^']*)'", (ROOT / 'setup.py').read_text(encoding='utf-8'))
    assert re.fullmatch(r'>=[\d.]+,<0\.12', spec)
    assert distribution('rosbags').version.startswith('0.11.')


def test_colcon_finds_the_tests():
    """It runs pytest where an extra that is called `test` names it."""
    call = next(node for node in ast.walk(ast.parse((ROOT / 'setup.py').read_text('utf-8')))
                if isinstance(node, ast.Call) and getattr(node.func, 'id', '') == 'setup')
    extras = next(ast.literal_eval(word.value) for word in call.keywords
                  if word.arg == 'extras_require')
    assert 'pytest' in extras['test']
    assert {f'python3-{name}' for name in extras['test']} <= manifest('test_depend')
    # And can import them with what is declared: one that it cannot ends the run.
    declared = {*extras['test'], *KEYS, *ROS, 'yaml', 'hydro_twin', 'benchmarks',
                *(path.stem for path in (ROOT / 'test').rglob('*.py'))}
    for path in (ROOT / 'test').rglob('*.py'):
        tree = ast.parse(path.read_text('utf-8'))
        names = {name for node in tree.body if isinstance(node, ast.Import | ast.ImportFrom)
                 for name in ([node.module] if isinstance(node, ast.ImportFrom)
                              else [alias.name for alias in node.names])}
        foreign = {name.partition('.')[0] for name in names} - {*sys.stdlib_module_names}
        assert not foreign - declared or 'importorskip' in path.read_text('utf-8'), path


def test_the_manifest_names_what_ros_tools_look_for():
    assert manifest('author')
    assert all((ROOT / path).is_file() for path in manifest('rosdoc2'))
    assert manifest('rosdoc2')
    assert 'ament_flake8' in manifest('test_depend')


def test_rosdoc2_has_what_its_builders_require():
    """A name and a folder for each, or it ends with "entry without 'output_dir' field found"."""
    (path,) = manifest('rosdoc2')
    about, settings = yaml.safe_load_all((ROOT / path).read_text('utf-8'))
    assert about == {'type': 'rosdoc2 config', 'version': 1}
    for builder in settings['builders']:
        ((kind, keys),) = builder.items()
        assert kind == 'sphinx'
        assert {'name', 'output_dir'} <= set(keys) <= {'name', 'output_dir', 'sphinx_sourcedir'}
        assert (ROOT / keys['sphinx_sourcedir'] / 'conf.py').is_file()
    assert (ROOT / settings['settings']['python_source'] / '__init__.py').is_file()
