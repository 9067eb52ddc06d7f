import gzip

import numpy as np
import pytest
from scipy.io import savemat

from hydro_twin.errors import BagError, UserError
from hydro_twin.recording.table import load_map, read_table, START

MAP = """
plant: cylinder
time: {column: t, unit: ms}
signals:
  command: {product: [direction, speed], unit: rpm, scale: -2}
  x: {column: x, unit: mm, offset: 0.5}
"""
CSV = 't,speed,direction,x,note\n' + ''.join(
    f'{2 * k},{10 * k},{-1 if k % 2 else 1},{k / 8},-\n' for k in range(20))


def table_map(tmp_path, text=MAP):
    path = tmp_path / 'map.yaml'
    path.write_text(text)
    return load_map(path)


def expected():
    k = np.arange(20)
    return (-2 * np.where(k % 2, -1, 1) * 10 * k * 2 * np.pi / 60, k / 8 * 1e-3 + 0.5)


@pytest.mark.parametrize('form', ['comma', 'semicolon', 'gzip', 'mat', 'quoted'])
def test_units_scale_and_product(tmp_path, form):
    path = tmp_path / {'gzip': 'a.csv.gz', 'mat': 'a.mat'}.get(form, 'a.csv')
    if form == 'gzip':
        path.write_bytes(gzip.compress(CSV.encode()))
    elif form == 'mat':
        k = np.arange(20.0)
        savemat(path, {'t': 2 * k[:, None], 'speed': 10 * k, 'x': k[None] / 8,
                       'direction': np.where(k % 2, -1, 1)})
    elif form == 'quoted':
        names, _, rows = CSV.partition('\n')
        path.write_text('\ufeff' + ', '.join(f'"{n}"' for n in names.split(',')) + '\n' + rows)
    else:
        path.write_text(CSV.replace(',', ';') if form == 'semicolon' else CSV)
    (series,) = read_table(path, table_map(tmp_path))
    command, x = expected()
    assert (series.sample_time, series.start) == (0.002, START)
    np.testing.assert_allclose(series['command'], command, rtol=1e-14)
    np.testing.assert_allclose(series['x'], x, rtol=1e-14)


def test_sample_rate_and_a_number_that_goes_for_all_rows(tmp_path):
    savemat(tmp_path / 'a.mat', {'gain': 3.0, 'u': np.arange(9.0)})
    (series,) = read_table(tmp_path / 'a.mat', table_map(tmp_path, """
plant: cylinder
sample_rate: 250
signals: {command: {product: [u, gain]}, x: gain}
"""))
    assert series.sample_time == 0.004
    assert series['command'].tolist() == [3.0 * k for k in range(9)]
    assert series['x'].tolist() == [3.0] * 9


def test_series_by_a_column_and_by_pauses(tmp_path):
    rows = [(0, 1), (1, 1), (2, 1), (7, 1), (8, 1), (3, 2), (4, 2), (5, 2)]
    (tmp_path / 'a.csv').write_text('t,run\n' + ''.join(f'{t},{run}\n' for t, run in rows))
    series = read_table(tmp_path / 'a.csv', table_map(tmp_path, """
plant: cylinder
time: t
series: run
signals: {command: t, x: run}
"""))
    assert [s['command'].tolist() for s in series] == [[0, 1, 2], [7, 8], [3, 4, 5]]
    assert (series[0].start, series[1].start) == (START, START + 7 * 10**9)
    assert series[2].start > series[1].start + 2 * 10**9


@pytest.mark.parametrize(('text', 'says'), [
    ('', 'not a map file'),
    ('plant: cylinder\nsignals: {x: x}', "either 'time'"),
    ('plant: cylinder\nsignals: {x: x}\ntime: t\nsample_rate: 1', "either 'time'"),
    ('plant: cylinder\nsignals: {x: x}\nrate: 5', 'unknown rate'),
    ('plant: cylinder\nsignals: {x: x}\nsample_rate: 0', 'above zero'),
    ('plant: cylinder\nsignals: {x: x}\nsample_rate: often', 'finite number'),
    ('plant: cylinder\nsignals: {x: {unit: mm}}\ntime: t', 'signal x needs either'),
    ('plant: cylinder\nsignals: {x: {column: x, unit: inch}}\ntime: t', "unit 'inch'.*mm"),
    ('plant: cylinder\nsignals: {x: {column: x, gain: 1}}\ntime: t', 'unknown gain'),
    ('plant: cylinder\nsignals: {x: {product: x}}\ntime: t', 'list of columns'),
    ('plant: cylinder\nsignals: {x: {column: x, scale: a}}\ntime: t', 'scale must be a finite'),
])
def test_mistakes_in_a_map_file(tmp_path, text, says):
    with pytest.raises(UserError, match=says) as caught:
        table_map(tmp_path, text)
    assert '\n' not in str(caught.value)
    assert 'map.yaml' in str(caught.value)


@pytest.mark.parametrize(('name', 'content', 'says'), [
    ('absent.csv', None, 'no such table'),
    ('a.xlsx', b'PK', 'a table is .csv'),
    ('a.csv', b'', 'no column direction, speed, t, x'),
    ('a.csv', b't,speed,direction\n', 'no column x; it has t, speed, direction'),
    ('a.csv', b't,speed,direction,x\n', 'has no rows'),
    ('a.csv', b't,speed,direction,x\n1,2,3\n', 'cannot be read'),
    ('a.csv', b't,speed,direction,x\n1,2,3,oops\n', 'oops'),
    ('a.csv', b't,speed,direction,x\n1,2,3,\n', 'cannot be read'),
    ('a.csv', b't,speed,direction,x\n1,2,3,4\n2,2,3,nan\n', 'column x is not a finite.*row 2'),
    ('a.csv', b't,speed,direction,x\n1,2,3,4\n3,2,3,4\n3,2,3,4\n', 'not increase at row 3'),
    ('a.csv', b't,speed,direction,x\n1,2,3,4\n', 'not increase'),
    ('a.csv', b'\xff\xfe\x00\x01', 'cannot be read'),
    ('a.csv.gz', b'not gzip', 'cannot be read'),
    ('a.mat', b'not a mat file' * 20, 'MAT file'),
    ('a.mat', b'', 'MAT file'),
])
def test_mistakes_in_a_table(tmp_path, name, content, says):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(BagError, match=says) as caught:
        read_table(tmp_path / name, table_map(tmp_path))
    assert '\n' not in str(caught.value)


def test_mat_variables_that_are_no_columns(tmp_path):
    good = {'t': np.arange(9.0), 'speed': np.ones(9), 'direction': np.ones(9)}
    for x, says in ((np.ones((3, 3)), 'x is 3 x 3'), (np.ones(8), 'different lengths'),
                    (np.array(['text']), 'cannot be read'), ({'a': 1}, 'cannot be read')):
        savemat(tmp_path / 'a.mat', good | {'x': x})
        with pytest.raises(BagError, match=says):
            read_table(tmp_path / 'a.mat', table_map(tmp_path))
