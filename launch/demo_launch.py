"""Fits a model to a recording that comes along, then runs the live twin on that recording."""
import tempfile

from launch import LaunchDescription
from launch.actions import ExecuteProcess, IncludeLaunchDescription, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import PathJoinSubstitution
from launch_ros.substitutions import FindPackageShare

RUN = ['ros2', 'run', 'hydro_twin']


def generate_launch_description():
    """Describe the fit, and what starts when it is done."""
    share = FindPackageShare('hydro_twin')
    bag = PathJoinSubstitution([share, 'bags', 'load_simulator_linear'])
    model = f'{tempfile.mkdtemp(prefix="hydro_twin_")}/model.yaml'
    fit = ExecuteProcess(cmd=[*RUN, 'refit', bag, '--plant', 'load_simulator', '-o', model],
                         output='screen')
    twin = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(PathJoinSubstitution([share, 'launch', 'twin_launch.py'])),
        launch_arguments={'model': model, 'plant': 'load_simulator', 'mode': 'free_run',
                          'use_sim_time': 'true'}.items())
    play = ExecuteProcess(cmd=[*RUN, 'replay', bag, '--publish', '--loop', '--clock'],
                          output='screen')
    return LaunchDescription([
        fit,
        RegisterEventHandler(OnProcessExit(
            target_action=fit,
            on_exit=lambda event, _: [twin, play] if event.returncode == 0 else [])),
    ])
