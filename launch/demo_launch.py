"""Traces what a model lacks on a recording, then runs it with and without that, side by side."""
import atexit
import shutil
import tempfile

from launch import LaunchDescription
from launch.actions import (
    ExecuteProcess,
    IncludeLaunchDescription,
    OpaqueFunction,
    RegisterEventHandler,
)
from launch.event_handlers import OnProcessExit
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import PathJoinSubstitution
from launch_ros.substitutions import FindPackageShare

RUN = ['ros2', 'run', 'hydro_twin']


def generate_launch_description():
    """Describe what is done when it is run, not before: that makes a folder."""
    return LaunchDescription([OpaqueFunction(function=demonstration)])


def demonstration(context):
    """Make the trace, and what starts when it is done."""
    del context
    folder = tempfile.mkdtemp(prefix='hydro_twin_')
    # At the end of the process, because the trace and the twin outlast the shutdown of launch.
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    share = FindPackageShare('hydro_twin')
    bag = PathJoinSubstitution([share, 'bags', 'rig_a'])
    traced = f'{folder}/traced'
    trace = ExecuteProcess(cmd=[*RUN, 'trace', bag, '--plant', 'load_simulator', '-o', traced],
                           output='screen')
    twin = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(PathJoinSubstitution([share, 'launch', 'twin_launch.py'])),
        launch_arguments={'model': f'{traced}/model.yaml',
                          'models': f'[before={traced}/before.yaml]',
                          'plant': 'load_simulator', 'mode': 'free_run',
                          'use_sim_time': 'true'}.items())
    play = ExecuteProcess(cmd=[*RUN, 'replay', bag, '--publish', '--loop', '--clock'],
                          output='screen')
    return [
        trace,
        RegisterEventHandler(OnProcessExit(
            target_action=trace,
            on_exit=lambda event, _: [twin, play] if event.returncode == 0 else [])),
    ]
