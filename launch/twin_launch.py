"""Starts the live twin of one plant, and `keep` beside it if that is asked for."""
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode, Node
from launch_ros.parameter_descriptions import ParameterValue

from hydro_twin.keep.settings import SETTINGS as KEEP
from hydro_twin.live.settings import SETTINGS
from hydro_twin.plants import PLANTS

TYPES = {'model': str, 'models': list[str], 'plant': str, 'mode': str, 'horizon': int,
         'follow': list[str], 'wait': float, 'autostart': bool,
         'use_sim_time': bool}   # parameters that are arguments
ABOUT = {setting.name: setting.description for setting in SETTINGS}
POLICY = next(setting for setting in KEEP if setting.name == 'policy')
MODE = next(setting for setting in SETTINGS if setting.name == 'mode')


def generate_launch_description():
    """Describe the node, with what is usually changed as arguments."""
    return LaunchDescription([
        DeclareLaunchArgument('model', description=ABOUT['model']),
        DeclareLaunchArgument('models', default_value="['']",
                              description=f'[NAME=PATH, ...]: {ABOUT["models"]}'),
        DeclareLaunchArgument('plant', default_value='', choices=['', *PLANTS],
                              description=ABOUT['plant']),
        DeclareLaunchArgument('config', default_value='',
                              description='parameter file with the signal map of your rig; '
                              'if not given, the one that comes with the plant'),
        DeclareLaunchArgument('mode', default_value=MODE.default, choices=MODE.choices,
                              description=MODE.description),
        DeclareLaunchArgument('horizon', default_value='1', description=ABOUT['horizon']),
        DeclareLaunchArgument('follow', default_value="['']",
                              description=f'[NAME=RATE, ...]: {ABOUT["follow"]}'),
        DeclareLaunchArgument('wait', default_value='0.1', description=ABOUT['wait']),
        DeclareLaunchArgument('autostart', default_value='true', choices=['true', 'false'],
                              description=ABOUT['autostart']),
        DeclareLaunchArgument('use_sim_time', default_value='false', choices=['true', 'false'],
                              description='take the time from /clock'),
        DeclareLaunchArgument('name', default_value='hydro_twin', description='of the node'),
        DeclareLaunchArgument('namespace', default_value='',
                              description='of the node, and of its topics without a slash'),
        DeclareLaunchArgument('log_level', default_value='info',
                              choices=['debug', 'info', 'warn', 'error', 'fatal'],
                              description='from which severity on the node writes to the log'),
        DeclareLaunchArgument('keep', default_value='', description='store of model versions; if '
                              'given, keep runs beside the node, as NAME_keep'),
        DeclareLaunchArgument('policy', default_value=POLICY.default, choices=POLICY.choices,
                              description=f'of keep: {POLICY.description}'),
        OpaqueFunction(function=twin),
    ])


def twin(context):
    """Make the node; it starts itself, by its parameter `autostart`, so launch must not."""
    parameters = [{name: ParameterValue(LaunchConfiguration(name), value_type=kind)
                   for name, kind in TYPES.items()
                   if name != 'plant' or LaunchConfiguration(name).perform(context)}]
    if config := LaunchConfiguration('config').perform(context):
        parameters.insert(0, config)
    level = ['--log-level', LaunchConfiguration('log_level')]
    made = [LifecycleNode(
        package='hydro_twin', executable='node', output='screen', parameters=parameters,
        name=LaunchConfiguration('name'), namespace=LaunchConfiguration('namespace'),
        ros_arguments=level)]
    if LaunchConfiguration('keep').perform(context):
        made.append(keep(config, level))
    return made


def keep(config, level):
    """Make the node that keeps the model of the twin true."""
    parameters = {name: ParameterValue(LaunchConfiguration(argument), value_type=kind)
                  for name, argument, kind in (
                      ('store', 'keep', str), ('twin', 'name', str), ('plant', 'plant', str),
                      ('policy', 'policy', str), ('use_sim_time', 'use_sim_time', bool))}
    return Node(
        package='hydro_twin', executable='keep', output='screen', ros_arguments=level,
        parameters=[config, parameters] if config else [parameters],
        name=[LaunchConfiguration('name'), '_keep'], namespace=LaunchConfiguration('namespace'))
