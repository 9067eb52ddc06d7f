"""Traces what a model lacks on a recording, then runs it with and without that, side by side."""
import tempfile

from launch import LaunchDescription
from launch.actions import ExecuteProcess, IncludeLaunchDescription, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import PathJoinSubstitution
from launch_ros.substitutions import FindPackageShare

RUN = ['ros2', 'run', 'hydro_twin']


def generate_launch_description():
    """Describe the trace, and what starts when it is done."""
    share = FindPackageShare('hydro_twin')
    bag = PathJoinSubstitution([share, 'bags', 'rig_a'])
    traced = f'{tempfile.mkdtemp(prefix="hydro_twin_")}/traced'
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
    return LaunchDescription([
        trace,
        RegisterEventHandler(OnProcessExit(
            target_action=trace,
            on_exit=lambda event, _: [twin, play] if event.returncode == 0 else [])),
    ])
