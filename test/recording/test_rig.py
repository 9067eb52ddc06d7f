"""What a configuration may say of a rig."""
import pytest

from hydro_twin.errors import UserError
from hydro_twin.plants import PLANTS
from hydro_twin.recording.rig import rig_of


@pytest.mark.parametrize(('line', 'meant'), [
    ('sampletime: 0.004', 'sample_time'), ('constant: {D_m: 2.0e-5}', 'constants'),
    ('signal: {u_m: {scale: 2.0}}', 'signals'), ('folow: [B_m]', 'follow')])
def test_a_misspelt_parameter_is_not_ignored(tmp_path, line, meant):
    config = tmp_path / 'rig.yaml'
    config.write_text(f'/**: {{ros__parameters: {{{line}}}}}')
    with pytest.raises(UserError, match=f"no parameter '.*'; is '{meant}' meant"):
        rig_of(PLANTS['load_simulator'], config)


@pytest.mark.parametrize(('value', 'said'), [
    ('5', '5'), ('[3]', r'\[3\]'), ('K_q', "'K_q'"), ('{tau: 1}', "{'tau': 1}"), ('0', '0')])
def test_what_to_follow_is_a_list_of_names(tmp_path, value, said):
    config = tmp_path / 'rig.yaml'
    config.write_text(f'/**: {{ros__parameters: {{follow: {value}}}}}')
    with pytest.raises(UserError, match=f'{config}: follow must be a list of NAME or NAME=RATE, '
                       f'not {said}$'):
        rig_of(PLANTS['load_simulator'], config)


@pytest.mark.parametrize(('value', 'follow'), [
    ('[]', ()), ('', ()), ("['']", ('',)), ('[B_m, J=1e-3]', ('B_m', 'J=1e-3'))])
def test_nothing_need_be_followed(tmp_path, value, follow):
    config = tmp_path / 'rig.yaml'
    config.write_text(f'/**: {{ros__parameters: {{follow: {value}}}}}')
    assert rig_of(PLANTS['load_simulator'], config).follow == follow


def test_parameters_of_other_nodes_are_left_to_them(tmp_path):
    config = tmp_path / 'rig.yaml'
    config.write_text('driver: {ros__parameters: {rate: 500, topics: [a], plant_name: rig}}\n'
                      '/**: {ros__parameters: {mode: observer, sample_time: 0.004}}')
    assert rig_of(PLANTS['load_simulator'], config).clock.given == pytest.approx(0.004)
