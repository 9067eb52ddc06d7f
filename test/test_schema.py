"""The schemas against what is shipped and written, and against what the readers refuse."""
import json
from pathlib import Path

from jsonschema import Draft202012Validator
import pytest
from trace_by_hand import result
import yaml

from hydro_twin.commands.main import main
from hydro_twin.errors import ModelError, UserError
from hydro_twin.live.settings import SETTINGS
from hydro_twin.model import document, Model, Noise, place, read_model, Record, Uncertainty
from hydro_twin.plants import PLANTS
from hydro_twin.recording.signals import load_signals
from hydro_twin.recording.table_map import load_map
from hydro_twin.report.summary import summarise
from hydro_twin.schema import DOCUMENTS, fault, json_schema

CONFIG = Path(__file__).parents[1] / 'config'
PLANT = PLANTS['load_simulator']


def is_config(path):
    return 'ros__parameters:' in path.read_text('utf-8')


FILES = sorted(CONFIG.rglob('*.yaml'))


def model():
    values = {'D_m': 2.2e-5} | PLANT.middle() | {'V_m': 1.7e-4, 'J': 0.05, 'G': 1e4}
    uncertainty = {p.name: Uncertainty(std_error=1e-3 * p.lower) for p in PLANT.parameters} | {
        'V_m': Uncertainty(identifiable=False), 'J': Uncertainty(at_bound='upper'),
        'G': Uncertainty(identifiable=False, held=True), '0:coulomb': Uncertainty(std_error=0.1)}
    return document(Model(
        PLANT, values, 0.002, (place('friction', 'motor', {'coulomb': 11.2}, PLANT),),
        {'u_m': -0.001}, noise=Noise(0.5, {'x_v': 1e-6}, dict.fromkeys(PLANT.states, 0.2)),
        record=Record(uncertainty, {'after': {'one_step': {'train': 0.5, 'test': 0.6}}},
                      {'seed': 3, 'bags': [{'path': 'a bag', 'sha256': 'ab' * 32}]},
                      ('a note',))))


def valid(raw, kind):
    """Whether jsonschema takes a document; msgspec, whose types these are, must agree."""
    taken = Draft202012Validator(json_schema(kind)).is_valid(raw)
    if taken:
        assert fault(raw, kind) == ''
    return taken


@pytest.mark.parametrize('kind', DOCUMENTS)
def test_the_schemas_are_schemas(kind):
    Draft202012Validator.check_schema(json_schema(kind))
    assert not valid([], kind)
    assert not valid({}, kind)


@pytest.mark.parametrize('path', sorted((CONFIG.parent / 'docs' / 'measured').glob('*.yaml')),
                         ids=lambda path: path.stem)
def test_models_written_by_hand_are_read(path):
    """Their unit may be 1, which YAML reads as a number."""
    assert valid(yaml.safe_load(path.read_text('utf-8')), 'model')
    assert read_model(path).effects


@pytest.mark.parametrize('path', FILES, ids=lambda path: path.stem)
def test_what_is_shipped_is_valid(path):
    assert valid(yaml.safe_load(path.read_text('utf-8')), 'config' if is_config(path) else 'map')


def test_what_is_written_is_valid():
    assert valid(model(), 'model')
    for more in {}, {'found': False}, {'curve': True}:
        written = summarise(result('positioning', **more))
        assert valid(json.loads(json.dumps(written)), 'report')
        assert not valid({**written, 'verdict': 'perhaps'}, 'report')


def put(raw, keys, value):
    """Set an entry, or take it away with None."""
    *way, last = keys
    for key in way:
        raw = raw[key]
    if value is None:
        del raw[last]
    else:
        raw[last] = value


@pytest.mark.parametrize(('keys', 'value'), [
    (['format'], 99), (['plant'], None), (['parameters', 'J', 'value'], 'heavy'),
    (['parameters', 'J', 'value'], None), (['parameters'], [1, 2]), (['sample_time'], 0.0),
    (['substeps'], 2.5), (['substeps'], 0), (['effects', 0, 'id'], None),
    (['parameters', 'J', 'std_error'], 'small'),
    # What no figure hangs on, which the reader takes from the types.
    (['effects', 0, 'parameters', 'coulomb', 'std_error'], 'small'), (['notes'], [3]),
    (['observer', 'measurement_noise'], 0.0), (['observer', 'start'], None),
    (['network'], 7), (['parameters', 'J', 'at_bound'], 'sideways'), (['errors'], [0.5]),
    (['errors', 'after', 'one_step', 'test'], 'low'), (['provenance', 'bags', 0, 'path'], None),
])
def test_a_model_that_is_not_valid_is_refused(tmp_path, keys, value):
    raw = model()
    put(raw, keys, value)
    raw = json.loads(json.dumps(raw))
    path = tmp_path / 'model.yaml'
    path.write_text(yaml.safe_dump(raw))
    assert not valid(raw, 'model')
    with pytest.raises(ModelError) as caught:
        read_model(path)
    assert '\n' not in str(caught.value)


@pytest.mark.parametrize(('keys', 'value'), [
    (['signals'], None), (['signals', 'x', 'colour'], 'red'), (['signals', 'x', 'unit'], 'ell'),
    (['signals', 'x', 'column'], None), (['signals', 'x', 'product'], ['a', 'b']),
    (['signals', 'x', 'scale'], 'large'), (['time'], None), (['sample_rate'], 100.0),
    (['rows'], [1]), (['time_range'], ['begin', 3]), (['colour'], 'red'),
])
def test_a_map_that_is_not_valid_is_refused(tmp_path, keys, value):
    raw = {'plant': 'cylinder', 'time': {'column': 't', 'unit': 's'}, 'rows': [2, None],
           'signals': {'command': 'a', 'x': {'column': 'b', 'unit': 'mm', 'scale': '1e-3'}}}
    assert valid(raw, 'map')
    put(raw, keys, value)
    path = tmp_path / 'map.yaml'
    path.write_text(yaml.safe_dump(raw))
    assert not valid(raw, 'map')
    with pytest.raises(UserError):
        load_map(path)


@pytest.mark.parametrize(('key', 'value'), [
    ('colour', 'red'), ('type', 'JointState'), ('field', 'position['), ('scale', 'large'),
])
def test_a_configuration_that_is_not_valid_is_refused(tmp_path, key, value):
    raw = yaml.safe_load((CONFIG / 'load_simulator.yaml').read_text('utf-8'))
    raw['/**']['ros__parameters']['signals']['u_m'][key] = value
    path = tmp_path / 'rig.yaml'
    path.write_text(yaml.safe_dump(raw))
    assert not valid(raw, 'config')
    with pytest.raises(UserError):
        load_signals('load_simulator', [signal.name for signal in PLANT.signals], path)


def test_the_schema_of_a_configuration_has_the_parameters_of_the_node():
    parameters = json_schema('config')['$defs']['ConfigParameters']['properties']
    given = {setting.name: setting.default for setting in SETTINGS}
    assert set(given) | {'signals', 'constants'} == set(parameters)
    for name, default in given.items():
        said = parameters[name].get('default')
        assert (tuple(said) or ('',) if isinstance(said, list) else said) in (default, None), name


@pytest.mark.parametrize('kind', DOCUMENTS)
def test_the_command_writes_what_it_prints(tmp_path, capsys, kind):
    assert main(['schema', kind, '-o', str(tmp_path / 's.json'), '--json']) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed == json.loads((tmp_path / 's.json').read_text()) == json_schema(kind)
    assert main(['schema', kind]) == 0
    assert json.loads(capsys.readouterr().out) == printed
