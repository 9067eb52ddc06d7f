"""A rig with friction from minute 2 and backlash from minute 6 on, its twin, and `keep`."""
from pathlib import Path
import sys
import tempfile

from launch import LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    ExecuteProcess,
    IncludeLaunchDescription,
    OpaqueFunction,
)
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.substitutions import FindPackageShare

# A capture and a trial as short as this rig allows, whose command repeats every 6 s.
KEEP = """/hydro_twin_keep:
  ros__parameters: {before: 60.0, after: 20.0, trial_least: 10.0, again: 60.0}
"""


def generate_launch_description():
    """Describe what is done when it is run, not before: that makes a folder."""
    return LaunchDescription([
        DeclareLaunchArgument('store', default_value='', description='folder for the versions; '
                              'if not given, a temporary one, which stays'),
        OpaqueFunction(function=loop)])


def loop(context):
    """Start the three."""
    from hydro_twin.ros.worn_rig import first_model

    folder = Path(tempfile.mkdtemp(prefix='hydro_twin_'))
    store = LaunchConfiguration('store').perform(context) or str(folder / 'store')
    (folder / 'keep.yaml').write_text(KEEP, 'utf-8')
    share = FindPackageShare('hydro_twin')
    return [
        ExecuteProcess(cmd=[sys.executable, '-m', 'hydro_twin.ros.worn_rig', '--at', '120', '360'],
                       output='screen'),
        IncludeLaunchDescription(
            PythonLaunchDescriptionSource(
                PathJoinSubstitution([share, 'launch', 'twin_launch.py'])),
            launch_arguments={'model': str(first_model(folder / 'first.yaml')),
                              'plant': 'load_simulator', 'mode': 'free_run',
                              'config': str(folder / 'keep.yaml'), 'keep': store,
                              'policy': 'auto'}.items()),
    ]
