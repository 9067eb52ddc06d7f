from bags_by_hand import header, joint_state, STORE
import pytest

from hydro_twin.errors import UserError
from hydro_twin.plants import PLANTS
from hydro_twin.recording.signals import (
    default_config,
    load_constants,
    load_parameters,
    load_signals,
    SignalMap,
)

JOINT_STATE = 'sensor_msgs/msg/JointState'
DEFAULTS = {   # the contract
    ('load_simulator', 'u_m'): ('/load_simulator/command', 'position[0]'),
    ('load_simulator', 'theta_d'): ('/load_simulator/joint_states', 'position[0]'),
    ('load_simulator', 'T_g'): ('/load_simulator/joint_states', 'effort[0]'),
    ('valve_servo', 'command'): ('/valve_servo/command', 'position[0]'),
    ('valve_servo', 'opening'): ('/valve_servo/joint_states', 'position[0]'),
    ('cylinder', 'command'): ('/cylinder/command', 'position[0]'),
    ('cylinder', 'x'): ('/cylinder/joint_states', 'position[0]'),
    ('positioning', 'force'): ('/positioning/command', 'effort[0]'),
    ('positioning', 'x'): ('/positioning/joint_states', 'position[0]'),
    ('rotary_axis', 'torque'): ('/rotary_axis/command', 'effort[0]'),
    ('rotary_axis', 'theta'): ('/rotary_axis/joint_states', 'position[0]'),
    ('drive', 'torque'): ('/drive/command', 'effort[0]'),
    ('drive', 'omega'): ('/drive/joint_states', 'velocity[0]'),
    ('control_valve', 'command'): ('/control_valve/command', 'position[0]'),
    ('control_valve', 'opening'): ('/control_valve/joint_states', 'position[0]'),
}


def config(tmp_path, text):
    path = tmp_path / 'config.yaml'
    path.write_text(text)
    return path


def test_defaults_of_every_plant():
    found = {}
    for plant in PLANTS.values():
        for name, signal in load_signals(plant.name, [s.name for s in plant.signals]).items():
            assert (signal.type, signal.scale, signal.offset) == (JOINT_STATE, 1.0, 0.0)
            found[plant.name, name] = (signal.topic, signal.field)
        constants = {constant.name: constant.value for constant in plant.constants}
        assert load_constants(plant.name) == constants
    assert found == DEFAULTS


def test_file_changes_what_it_names_and_leaves_the_rest(tmp_path):
    path = config(tmp_path, """
/twin:
  ros__parameters:
    mode: free_run
    signals:
      u_m: {topic: /valve/u, type: std_msgs/msg/Float64, field: data, scale: 1e-3, offset: -2}
    signals.T_g.field: effort[shaft]
    constants: {D_m: 2.2e-5}
""")
    signals = load_signals('load_simulator', ['u_m', 'theta_d', 'T_g'], path)
    assert signals['u_m'] == SignalMap('/valve/u', 'std_msgs/msg/Float64', 'data', 1e-3, -2.0)
    assert signals['T_g'].field == 'effort[shaft]'
    assert signals['T_g'].topic == '/load_simulator/joint_states'
    assert signals['theta_d'] == load_signals(
        'load_simulator', ['u_m', 'theta_d', 'T_g'])['theta_d']
    assert load_constants('load_simulator', path) == {'D_m': 2.2e-5}
    assert load_parameters(path)['mode'] == 'free_run'


@pytest.mark.parametrize(('text', 'says'), [
    ('a: [', 'not YAML'),
    ('a: 2020-13-45', 'not YAML'),
    ('[' * 5000, 'not YAML'),
    ('just text', 'not a ROS parameter file'),
    ('/**: {signals: {u_m: {scale: 2}}}', 'not a ROS parameter file'),
    ('/**: {ros__parameters: {signals: {u: {scale: 2}}}}', "no signal 'u'.*u_m, theta_d, T_g"),
    ('/**: {ros__parameters: {signals: {u_m: {topics: /a}}}}', "u_m has no 'topics'.*topic"),
    ('/**: {ros__parameters: {signals: {u_m: {topic: ""}}}}', 'u_m lacks topic'),
    ('/**: {ros__parameters: {signals: {u_m: {type: Float64}}}}', 'should read like sensor_msgs'),
    ('/**: {ros__parameters: {signals: {u_m: {field: "position["}}}}', 'should read like data'),
    ('/**: {ros__parameters: {signals: {u_m: {field: "a[b].c"}}}}', 'should read like data'),
    ('/**: {ros__parameters: {signals: {u_m: {scale: fast}}}}', 'finite number'),
    ('/**: {ros__parameters: {signals: {u_m: {scale: .nan}}}}', 'finite number'),
    ('/**: {ros__parameters: {signals: {u_m: {scale: true}}}}', 'finite number'),
    ('/**: {ros__parameters: {signals: {u_m: {scale: 0.0}}}}', 'must not be zero'),
    (f'/**: {{ros__parameters: {{signals: {{u_m: {{scale: 1{"0" * 400}}}}}}}}}', 'finite number'),
    ('/**: {ros__parameters: {signals: 5}}', 'signals must be a map of signals, not 5'),
])
def test_mistakes_in_the_file_are_one_line(tmp_path, text, says):
    path = config(tmp_path, text)
    with pytest.raises(UserError, match=says) as caught:
        load_signals('load_simulator', ['u_m', 'theta_d', 'T_g'], path)
    assert str(path) in str(caught.value)
    assert '\n' not in str(caught.value)


@pytest.mark.parametrize('text', ['signals:', 'signals: {u_m: }', 'plant:'])
def test_what_is_left_empty_is_as_usual(tmp_path, text):
    path = config(tmp_path, f'/**: {{ros__parameters: {{{text}}}}}')
    names = ['u_m', 'theta_d', 'T_g']
    assert load_signals('load_simulator', names, path) == load_signals('load_simulator', names)


def test_file_that_is_not_there(tmp_path):
    with pytest.raises(UserError, match='No such file'):
        load_signals('load_simulator', ['u_m'], tmp_path / 'absent.yaml')


def test_one_message_at_a_time():
    message = joint_state(5, ['shaft', 'rudder'], [1.0, 2.0], [3.0, 4.0])
    assert SignalMap('/t', JOINT_STATE, 'position[1]').read(message) == 2.0
    assert SignalMap('/t', JOINT_STATE, 'effort[shaft]', 2.0, 0.5).read(message) == 6.5
    assert SignalMap('/t', JOINT_STATE, 'effort[elevator]').read(message) is None
    assert SignalMap('/t', JOINT_STATE, 'header.stamp.nanosec').read(message) == 5.0
    vector = STORE.types['geometry_msgs/msg/Vector3']
    transform = STORE.types['geometry_msgs/msg/TransformStamped'](
        header(0), '', STORE.types['geometry_msgs/msg/Transform'](vector(0., 7., 0.), None))
    tf = STORE.types['tf2_msgs/msg/TFMessage']([None, transform])
    assert SignalMap('/t', '', 'transforms[1].transform.translation.y').read(tf) == 7.0
    with pytest.raises(IndexError):
        SignalMap('/t', JOINT_STATE, 'position[2]').read(message)
    with pytest.raises(AttributeError):
        SignalMap('/t', JOINT_STATE, 'torque').read(message)


def test_raw_undoes_of():
    signal = SignalMap('/t', JOINT_STATE, 'data', scale=4.0, offset=-3.0)
    assert signal.of(2.0) == 5.0
    assert signal.raw(5.0) == 2.0


def test_a_file_for_another_plant_is_refused_even_if_its_signals_have_the_same_names(tmp_path):
    path = tmp_path / 'mine.yaml'
    path.write_text(default_config('control_valve').read_text('utf-8'), 'utf-8')
    names = ['command', 'opening']
    assert load_signals('control_valve', names, path)['command'].topic == '/control_valve/command'
    with pytest.raises(UserError, match='control_valve, not valve_servo'):
        load_signals('valve_servo', names, path)


def test_default_topics_are_in_the_namespace_of_the_node():
    for plant in PLANTS:
        for name, value in load_parameters(default_config(plant)).items():
            if name.endswith('.topic'):
                assert value.startswith(f'{plant}/')
