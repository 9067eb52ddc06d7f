"""Package hydro_twin for pip and for colcon (ament_python)."""
from pathlib import Path

from setuptools import find_packages, setup

NAME = 'hydro_twin'
# A link to scripts/verb for each: colcon must know them without importing the package.
VERBS = sorted(path.name for path in Path('scripts').iterdir() if path.name != 'verb')
B19, L18 = f'{NAME}.studies.b19', f'{NAME}.studies.l18'


def share(folder: str, pattern: str) -> list[tuple[str, list[str]]]:
    """List the files of a folder, with its sub-folders, as data files of the package."""
    groups: dict[str, list[str]] = {}
    for path in sorted(Path(folder).rglob(pattern)):
        if path.is_file():
            groups.setdefault(f'share/{NAME}/{path.parent}', []).append(str(path))
    return list(groups.items())


setup(
    name=NAME,
    version='0.1.0',
    description='ROS 2 digital twin of electro-hydraulic actuators that improves its own model '
                'from recorded data',
    license='Apache-2.0',
    author='The hydro_twin developers',
    author_email='hydro_twin@users.noreply.github.com',
    maintainer='The hydro_twin developers',
    maintainer_email='hydro_twin@users.noreply.github.com',
    python_requires='==3.12.*',
    packages=find_packages(include=[NAME, f'{NAME}.*']),
    package_data={NAME: ['py.typed', 'report/*.html', 'report/*.jinja', 'report/*.css',
                         'report/*.js', 'fleet/*.html', 'fleet/*.js',
                         'studies/*/*.html']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
        # For `ros2 run`. As console scripts, `node` and `import` would end up in the PATH of a
        # plain install, before Node.js and ImageMagick.
        (f'lib/{NAME}', [f'scripts/{name}' for name in VERBS]),
        *share('config', '*'),
        *share('launch', '*_launch.py'),
        *share('bags', '*'),
    ],
    install_requires=[
        'jinja2>=3.1',
        'llvmlite>=0.42',
        'matplotlib>=3.6',
        'msgspec>=0.18',
        'numba>=0.59',
        'numpy>=1.26',
        'PyYAML>=6',
        'rich>=13',
        'rosbags>=0.11.9,<0.12',   # its files and its decompression are not for others: bag.py
        'safetensors>=0.4',
        'scipy>=1.11',
        'threadpoolctl>=3.1',
    ],
    extras_require={
        'ros': ['ros-jazzy-rclpy[fastrtps]', 'ros-jazzy-common-interfaces'],
        'learn': ['torch>=2.2'],
        'fleet': ['bokeh>=3.1', 'distributed>=2024.8', 'pyarrow>=15'],   # bokeh: the dashboard
        'test': ['hypothesis', 'jsonschema', 'pytest'],   # by which colcon test knows what to run
    },
    entry_points={
        'console_scripts': [f'hydro-twin = {NAME}.commands.main:main'],
        # What the studies add, in the way in which other packages may add theirs.
        f'{NAME}.verbs': [
            f'compare = {B19}.commands.compare:VERB',
            f'frequency-control = {L18}.commands.frequency_control:VERB',
            f'identify = {L18}.commands.identify:VERB',
        ],
        f'{NAME}.effect_options': [f'curve = {L18}.commands.curve:CURVE'],
        f'{NAME}.methods': [
            *(f'{name.lower()} = {B19}.populations:{name}' for name in ('BEES', 'EA', 'PSO',
                                                                        'RANDOM')),
            f'network = {L18}.method:NETWORK',
        ],
    },
)
