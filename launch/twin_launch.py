"""Starts the live twin of one plant."""
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare


def generate_launch_description():
    """Describe the node, with what is usually changed as arguments."""
    plant = LaunchConfiguration('plant')
    defaults = [PathJoinSubstitution([FindPackageShare('hydro_twin'), 'config', plant]), '.yaml']
    types = {'model': str, 'models': list[str], 'mode': str, 'use_sim_time': bool}
    return LaunchDescription([
        DeclareLaunchArgument('model', description='model file, as refit or trace writes it'),
        DeclareLaunchArgument('models', default_value="['']",
                              description='more of them, to run beside it: [NAME=PATH, ...]'),
        DeclareLaunchArgument(
            'plant', default_value='load_simulator',
            choices=['load_simulator', 'valve_servo', 'cylinder', 'positioning'],
            description='plant whose signal map is taken where no config is given'),
        DeclareLaunchArgument('config', default_value=defaults,
                              description='parameter file with the signal map of your rig'),
        DeclareLaunchArgument('mode', default_value='one_step', choices=['one_step', 'free_run'],
                              description='with or without the measured output'),
        DeclareLaunchArgument('use_sim_time', default_value='false',
                              description='take the time from /clock'),
        Node(
            package='hydro_twin', executable='node', name='hydro_twin', output='screen',
            parameters=[LaunchConfiguration('config'), {
                name: ParameterValue(LaunchConfiguration(name), value_type=kind)
                for name, kind in types.items()}]),
    ])
