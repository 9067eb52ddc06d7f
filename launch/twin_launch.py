"""Starts the live twin of one plant, and `keep` beside it if that is asked for."""
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode, Node
from launch_ros.parameter_descriptions import ParameterValue

from hydro_twin.keep.settings import SETTINGS as KEEP
from hydro_twin.live.settings import SETTINGS
from hydro_twin.plants import PLANTS

OF_NODE = {'model': str, 'models': list[str], 'plant': str, 'mode': str, 'horizon': int,
           'follow': list[str], 'wait': float, 'autostart': bool,
           'use_sim_time': bool}   # parameters that are arguments
OF_KEEP = {'keep': ('store', str), 'name': ('twin', str), 'plant': ('plant', str),
           'policy': ('policy', str), 'use_sim_time': ('use_sim_time', bool)}
POLICY = next(setting for setting in KEEP if setting.name == 'policy')
BOOLEAN = ('true', 'false')


def generate_launch_description():
    """Describe the node, with what is usually changed as arguments."""
    return LaunchDescription([
        DeclareLaunchArgument('config', default_value='',
                              description='parameter file with the signal map of your rig; '
                              'if not given, the one that comes with the plant'),
        *(of_parameter(setting) for setting in SETTINGS if setting.name in OF_NODE),
        DeclareLaunchArgument('use_sim_time', default_value='', choices=['', *BOOLEAN],
                              description='take the time from /clock'),
        DeclareLaunchArgument('name', default_value='hydro_twin', description='of the node'),
        DeclareLaunchArgument('namespace', default_value='',
                              description='of the node, and of its topics without a slash'),
        DeclareLaunchArgument('log_level', default_value='info',
                              choices=['debug', 'info', 'warn', 'error', 'fatal'],
                              description='from which severity on the node writes to the log'),
        DeclareLaunchArgument('keep', default_value='', description='store of model versions; if '
                              'given, keep runs beside the node, as NAME_keep'),
        of_parameter(POLICY, 'of keep: '),
        OpaqueFunction(function=twin),
    ])


def of_parameter(setting, about=''):
    """Make a parameter an argument; one that is not given leaves it to `config`."""
    description = about + setting.description
    if setting.name == 'model':
        return DeclareLaunchArgument('model', description=description)
    if setting.name in ('models', 'follow'):
        description = f'[A, B, ...]: {description}'
    elif setting.default != '':
        description += f'; if not given, that in config, else {str(setting.default).lower()}'
    choices = (list(PLANTS) if setting.name == 'plant' else
               BOOLEAN if isinstance(setting.default, bool) else setting.choices)
    return DeclareLaunchArgument(setting.name, default_value='', description=description,
                                 **({'choices': ['', *choices]} if choices else {}))


def twin(context):
    """Make the node; it starts itself, by its parameter `autostart`, so launch must not."""
    level = ['--log-level', LaunchConfiguration('log_level')]
    made = [LifecycleNode(
        package='hydro_twin', executable='node', output='screen', ros_arguments=level,
        parameters=parameters(context, {name: (name, kind) for name, kind in OF_NODE.items()}),
        name=LaunchConfiguration('name'), namespace=LaunchConfiguration('namespace'))]
    if LaunchConfiguration('keep').perform(context):
        made.append(Node(
            package='hydro_twin', executable='keep', output='screen', ros_arguments=level,
            parameters=parameters(context, OF_KEEP),
            name=[LaunchConfiguration('name'), '_keep'],
            namespace=LaunchConfiguration('namespace')))
    return made


def parameters(context, arguments):
    """Give a node its parameter file, and then the arguments that were given.

    Args:
        context: of the launch.
        arguments: of this file -> parameter of the node, its type.
    """
    given = {parameter: ParameterValue(LaunchConfiguration(name), value_type=kind)
             for name, (parameter, kind) in arguments.items()
             if LaunchConfiguration(name).perform(context)}
    config = LaunchConfiguration('config').perform(context)
    return [config, given] if config else [given]
