import gzip
from itertools import pairwise
import logging
from pathlib import Path
import re

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from scipy.io import savemat

from hydro_twin.errors import BagError, UserError
from hydro_twin.recording.grid import MAX_GAP
from hydro_twin.recording.table import read_tables, START
from hydro_twin.recording.table_map import load_map, units_in_bag

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


def test_a_decimal_comma(tmp_path):
    path = tmp_path / 'a.csv'
    path.write_text(CSV.replace(',', ';').replace('.', ','))
    assert '0,125' in path.read_text()
    with pytest.raises(BagError, match=r"row 1: '0,0'; for a decimal comma give decimal: ','"):
        read_tables([path], table_map(tmp_path))
    (series,) = read_tables([path], table_map(tmp_path, MAP + "decimal: ','\n"))
    for name, values in zip(('command', 'x'), expected(), strict=True):
        np.testing.assert_allclose(series[name], values, rtol=1e-12)
    path.write_text(CSV)
    with pytest.raises(BagError, match='a comma separates its columns'):
        read_tables([path], table_map(tmp_path, MAP + "decimal: ','\n"))
    with pytest.raises(UserError, match=r"decimal must be '.' or ',', not ';'"):
        table_map(tmp_path, MAP + "decimal: ';'\n")


def test_columns_without_names_are_counted(tmp_path):
    path = tmp_path / 'a.csv'
    path.write_text(CSV.partition('\n')[2])
    numbered = re.sub(r'\b(t|speed|direction|x)([},\]])', lambda name: str(
        1 + ['t', 'speed', 'direction', 'x'].index(name[1])) + name[2], MAP)
    (series,) = read_tables([path], table_map(tmp_path, numbered + 'header: false\n'))
    for name, values in zip(('command', 'x'), expected(), strict=True):
        np.testing.assert_allclose(series[name], values, rtol=1e-12)
    with pytest.raises(UserError, match="header must be true or false, not 'no'"):
        table_map(tmp_path, MAP + "header: 'no'\n")
    path.write_text('# ramp, 1 of 2, by hand\n\n# t, speed\n'
                    + CSV.partition('\n')[2].replace(',', '\t'))
    (below,) = read_tables(
        [path], table_map(tmp_path, numbered + 'header: false\nrows: [3, null]\n'))
    assert len(below) == len(series)
    np.testing.assert_array_equal(below['x'], series['x'])


@pytest.mark.parametrize('separator', [';', '\t', '   '])
def test_a_decimal_comma_without_names(tmp_path, separator):
    path = tmp_path / 'a.csv'
    path.write_text(''.join(separator.join((f'{k},0', f'{k},25', f'{k},5')) + '\n'
                            for k in range(20)))
    text = """
plant: cylinder
time: {column: 1}
signals: {command: {column: 2}, x: {column: 3}}
header: false
decimal: ','
"""
    (series,) = read_tables([path], table_map(tmp_path, text))
    assert series['command'].tolist() == [k + 0.25 for k in range(20)]
    assert series['x'].tolist() == [k + 0.5 for k in range(20)]


def test_a_damaged_archive_is_one_line(tmp_path):
    path = tmp_path / 'a.csv.gz'
    content = bytearray(gzip.compress(CSV.encode()))
    content[12:20] = bytes(range(248, 256))
    path.write_bytes(content)
    with pytest.raises(BagError, match=r'a\.csv\.gz cannot be read'):
        read_tables([path], table_map(tmp_path))


@pytest.mark.parametrize('form', ['mat', 'npz'])
@pytest.mark.parametrize(('more', 'column', 'says'), [
    ({'q': np.ones((1, 9))}, 'q[0]', 'q[0]: an array of 1 x 9 has one row; transpose it'),
    ({'x': 1j * np.ones(9)}, 'x', 'x is complex; save its real or its imaginary part')])
def test_arrays_that_would_be_misread(tmp_path, form, more, column, says):
    path = tmp_path / f'a.{form}'
    columns = {'u': np.arange(9.0), **more}
    savemat(path, columns) if form == 'mat' else np.savez(path, **columns)
    with pytest.raises(BagError, match=re.escape(f'{path}: {says}')):
        read_tables([path], table_map(tmp_path, f"""
plant: cylinder
sample_rate: 250
signals: {{command: u, x: '{column}'}}
"""))


def test_what_a_map_leaves_empty(tmp_path):
    found = table_map(tmp_path, MAP.replace('plant: cylinder', 'plant:') + 'origin:\n')
    assert (found.plant, found.origin) == ('', '')


def test_a_sample_rate_too_slow_for_stamps(tmp_path):
    (tmp_path / 'a.csv').write_text('u\n' + '1\n' * 20)
    with pytest.raises(BagError, match=r'span 1.9e\+10 s, more than stamps can: is the '
                       r'sample_rate right'):
        read_tables([tmp_path / 'a.csv'], table_map(
            tmp_path, 'plant: cylinder\nsample_rate: 1e-9\nsignals: {x: u, command: u}'))


def test_blanks_between_columns(tmp_path):
    path = tmp_path / 'a.txt'
    path.write_text('# ' + CSV.replace(',', '   '))
    (series,) = read_tables([path], table_map(tmp_path))
    for name, values in zip(('command', 'x'), expected(), strict=True):
        np.testing.assert_allclose(series[name], values, rtol=1e-12)
    path.write_text('t speed direction x\n 0 1 1 oops\n')
    with pytest.raises(BagError, match=r"column x is not a finite number in row 1: 'oops'"):
        read_tables([path], table_map(tmp_path))


def test_a_file_that_is_not_in_utf_8_says_so(tmp_path):
    path = tmp_path / 'a.csv'
    path.write_bytes(CSV.replace('note', 'Prüfer').encode('latin-1'))
    with pytest.raises(BagError, match='cannot be read: save it in UTF-8'):
        read_tables([path], table_map(tmp_path))


@pytest.mark.parametrize('form', ['comma', 'semicolon', 'gzip', 'mat', 'npz', 'quoted'])
def test_units_scale_and_product(tmp_path, form):
    path = tmp_path / {'gzip': 'a.csv.gz', 'mat': 'a.mat', 'npz': 'a.npz'}.get(form, 'a.csv')
    if form == 'gzip':
        path.write_bytes(gzip.compress(CSV.encode()))
    elif form in ('mat', 'npz'):
        k = np.arange(20.0)
        columns = {'t': 2 * k[:, None], 'speed': 10 * k, 'x': k[None] / 8,
                   'direction': np.where(k % 2, -1, 1)}
        savemat(path, columns) if form == 'mat' else np.savez(path, **columns)
    elif form == 'quoted':
        names, _, rows = CSV.partition('\n')
        path.write_text('\ufeff' + ', '.join(f'"{n}"' for n in names.split(',')) + '\n' + rows)
    else:
        path.write_text(CSV.replace(',', ';') if form == 'semicolon' else CSV)
    (series,) = read_tables([path], table_map(tmp_path))
    command, x = expected()
    assert series.stamps.tolist() == [START + 2_000_000 * k for k in range(20)]
    np.testing.assert_allclose(series['command'], command, rtol=1e-14)
    np.testing.assert_allclose(series['x'], x, rtol=1e-14)


def test_sample_rate_and_a_number_that_goes_for_all_rows(tmp_path):
    savemat(tmp_path / 'a.mat', {'gain': 3.0, 'u': np.arange(9.0)})
    (series,) = read_tables([tmp_path / 'a.mat'], table_map(tmp_path, """
plant: cylinder
sample_rate: 250
signals: {command: {product: [u, gain]}, x: gain}
"""))
    assert series.stamps.tolist() == [START + 4_000_000 * k for k in range(9)]
    assert series['command'].tolist() == [3.0 * k for k in range(9)]
    assert series['x'].tolist() == [3.0] * 9


def test_series_by_a_column_and_by_pauses(tmp_path):
    rows = [(0, 1), (1, 1), (2, 1), (8, 1), (9, 1), (3, 2), (4, 2), (5, 2)]
    (tmp_path / 'a.csv').write_text('t,run\n' + ''.join(f'{t},{run}\n' for t, run in rows))
    series = read_tables([tmp_path / 'a.csv'], table_map(tmp_path, """
plant: cylinder
time: t
series: run
signals: {command: t, x: run}
"""))
    assert [s['command'].tolist() for s in series] == [[0, 1, 2], [8, 9], [3, 4, 5]]
    assert (series[0].stamps[0], series[1].stamps[0]) == (START, START + 8 * 10**9)
    assert series[2].stamps[0] > series[1].stamps[-1] + MAX_GAP * 10**9


@pytest.mark.parametrize(('text', 'says'), [
    ('', 'not a map file'),
    ('plant: cylinder\nsignals: {x: x}', "either 'time'"),
    ('plant: cylinder\nsignals: {x: x}\ntime: t\nsample_rate: 1', "either 'time'"),
    ('plant: cylinder\nsignals: {x: x}\nrate: 5', 'unknown rate'),
    ('plant: cylinder\nsignals: {x: x}\nsample_rate: 0', 'above zero'),
    ('plant: cylinder\nsignals: {x: x}\nsample_rate: 1e12', 'not between 1e-09 and 1e.09 Hz'),
    ('plant: cylinder\nsignals: {x: x}\nsample_rate: 1e-320', 'not between 1e-09 and 1e.09 Hz'),
    ('plant: cylinder\nsignals: {x: x}\nsample_rate: often', 'finite number'),
    ('plant: cylinder\nsignals: {x: {unit: mm}}\ntime: t', 'signal x needs either'),
    ('plant: cylinder\nsignals: {x: {column: x, unit: inch}}\ntime: t', "unit 'inch'.*mm"),
    ('plant: cylinder\nsignals: {x: {column: x, gain: 1}}\ntime: t', 'unknown gain'),
    ('plant: cylinder\nsignals: {x: {product: x}}\ntime: t', 'list of columns'),
    ('plant: cylinder\nsignals: {x: {column: x, scale: a}}\ntime: t', 'scale must be a finite'),
    ('plant: cylinder\nsignals: {x: x}\ntime: {column: t, unit: mm}', 'mm is not a unit of time'),
    ('plant: cylinder\nsignals: {x: x}\ntime: t\nrows: [0, 5]', 'rows must be'),
    ('plant: cylinder\nsignals: {x: x}\ntime: t\nrows: [7, 5]', 'rows must be'),
    ('plant: cylinder\nsignals: {x: x}\ntime: t\nrows: [1.5, 5]', 'rows must be'),
    ('plant: cylinder\nsignals: {x: x}\ntime: t\nrows: 5', 'rows must be'),
    ('plant: cylinder\nsignals: {x: x}\ntime: t\ntime_range: [2]', 'time_range must be'),
    ('plant: cylinder\nsignals: {x: x}\ntime: t\ntime_range: [2, 2]', 'not after its start'),
    ('plant: cylinder\nsignals: {x: x}\ntime: t\ntime_range: [a, 2]', 'finite number'),
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
    ('a.csv', b't,speed,direction\n', 'no column x; it has t, speed, direction$'),
    ('a.csv', b'0.0,-1,2e3,4\n', 'it has 0.0, -1, 2e3, 4; for a table without a line of names'),
    ('a.csv', b't,speed,direction,x\n', 'has no rows'),
    ('a.csv', b't,speed,direction,x\n1,2,3\n', 'row 1 has no column x: it has 3 columns'),
    ('a.csv', b't,speed,direction,x\n1,2,3,4\n\n2,2,3,oops\n', "column x is.*row 2: 'oops'"),
    ('a.csv', b't,speed,direction,x\n1,2,3,4\n2,2,3,\n3,2,3,4\n', 'column x.*row 2: the cell'),
    ('a.csv', b't;speed;direction;x\n1;2;3;4,5\n', "column x is not a finite.*row 1: '4,5"),
    ('a.csv', b't,speed,direction,x,x\n1,2,3,4,5\n', 'several columns named x'),
    ('a.csv', b't,speed,direction,x\n1,2,3,4\n2,2,3,nan\n', 'column x is not a finite.*row 2'),
    ('a.csv', b't,speed,direction,x\nnan,2,3,4\n2,2,3,4\n', 'column t is not a finite.*row 1'),
    ('a.csv', b't,speed,direction,x\n1,2,3,4\n1,2,3,4\n3,2,3,4\n3,2,3,4\n',
     "2 of 4 rows have the time of the row before, the first is row 2.*'sample_rate'"),
    ('a.csv', b'\xff\xfe\x00\x01', 'cannot be read'),
    ('a.csv.gz', b'not gzip', 'cannot be read'),
    ('a.mat', b'not a mat file' * 20, 'MAT file'),
    ('a.mat', b'', 'MAT file'),
    ('a.npz', b'PK no archive', 'NPZ file'),
    ('a.npz', b'', 'NPZ file'),
])
def test_mistakes_in_a_table(tmp_path, name, content, says):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(BagError, match=says) as caught:
        read_tables([tmp_path / name], table_map(tmp_path))
    assert '\n' not in str(caught.value)


@pytest.mark.parametrize('name', ['a.npz', 'a.mat'])
def test_a_column_of_an_array_of_several(tmp_path, name):
    k = np.arange(9.0)
    arrays = {'t': k, 'q': np.column_stack([k, 10 * k])}
    if name == 'a.mat':
        savemat(tmp_path / name, arrays)
    else:
        np.savez(tmp_path / name, **arrays)
    said = 'plant: cylinder\ntime: {column: t}\nsignals: {command: "q[1]", x: "q[0]"}\n'
    (series,) = read_tables([tmp_path / name], table_map(tmp_path, said))
    assert series['command'].tolist() == (10 * k).tolist()
    with pytest.raises(BagError, match='index 2 is out of bounds'):
        read_tables([tmp_path / name], table_map(tmp_path, said.replace('q[0]', 'q[2]')))


@pytest.mark.parametrize(('x', 'says'), [
    (np.ones((3, 3)), 'x is 3 x 3'), (np.ones(8), 'different lengths'),
    (np.array(['text']), 'cannot be read'), (np.array([{}]), 'cannot be read')])
def test_arrays_that_are_no_columns(tmp_path, x, says):
    np.savez(tmp_path / 'a.npz', t=np.arange(9.0), speed=np.ones(9), direction=np.ones(9), x=x)
    with pytest.raises(BagError, match=says):
        read_tables([tmp_path / 'a.npz'], table_map(tmp_path))


def test_mat_variables_that_are_no_columns(tmp_path):
    good = {'t': np.arange(9.0), 'speed': np.ones(9), 'direction': np.ones(9)}
    for x, says in ((np.ones((3, 3)), 'x is 3 x 3'), (np.ones(8), 'different lengths'),
                    (np.array(['text']), 'cannot be read'), ({'a': 1}, 'cannot be read')):
        savemat(tmp_path / 'a.mat', good | {'x': x})
        with pytest.raises(BagError, match=says):
            read_tables([tmp_path / 'a.mat'], table_map(tmp_path))


PLAIN = """
plant: cylinder
time: {column: t, unit: UNIT}
signals: {command: u, x: x}
"""


def plain(tmp_path, rows, text=PLAIN, unit='s'):
    """Read a table of rows (t, u, x); t is written with all its digits."""
    (tmp_path / 'a.csv').write_text('t,u,x\n' + ''.join(f'{t!r},{u},{x}\n' for t, u, x in rows))
    return read_tables([tmp_path / 'a.csv'], table_map(tmp_path, text.replace('UNIT', unit)))


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6), rate=st.floats(0.2, 2000.0), jitter=st.floats(0.05, 0.9),
       length=st.integers(12, 200), runs=st.integers(1, 3))
def test_unsteady_times_are_the_stamps(tmp_path_factory, seed, rate, jitter, length, runs):
    rng = np.random.default_rng(seed)
    times = []
    for _ in range(runs):
        steps = rng.uniform(1.0 - jitter, 1.0 + jitter, length) / rate
        times.append(rng.uniform(-5.0, 5.0) + np.cumsum(steps) - 3.0 * length / rate)
    rows = [(float(t), k, -k) for k, t in enumerate(np.concatenate(times))]
    goes_back = [k + 1 for k in range(len(rows) - 1) if rows[k + 1][0] < rows[k][0]]
    if len(goes_back) < runs - 1:   # one run begins far after the end of the other
        return
    series = plain(tmp_path_factory.mktemp('table'), rows)
    assert [len(s) for s in series] == [length] * runs
    for one, there in zip(series, times, strict=True):
        np.testing.assert_allclose(one.stamps - one.stamps[0], (there - there[0]) * 1e9, atol=2)
    for before, after in pairwise(series):
        assert after.stamps[0] - before.stamps[-1] > MAX_GAP * 1e9 / rate * (1 - jitter)
    assert np.concatenate([s['command'] for s in series]).tolist() == list(range(len(rows)))


def test_a_series_ends_at_a_gap_only(tmp_path):
    """Pauses of up to five typical periods are bridged, as the reader of bags does."""
    pauses = [0.05] * 20 + [0.24] + [0.05] * 20 + [0.26] + [0.05] * 20
    time = np.concatenate([[0.0], np.cumsum(pauses)]).round(3).tolist()
    first, second = plain(tmp_path, [(t, 0, 0) for t in time])
    assert (len(first), len(second)) == (42, 21)
    assert second.stamps[0] - first.stamps[-1] == 260_000_000


@pytest.mark.parametrize(('unit', 'scale'), [('s', 1), ('ms', 1e3), ('us', 1e6), ('ns', 1e9)])
@pytest.mark.parametrize('since', [0, 1_700_000_000])
def test_time_in_any_unit_from_any_beginning(tmp_path, unit, scale, since):
    """Seconds since 1970 leave 240 ns in floating point, which are not jitter."""
    times = [(since + 0.002 * k) * scale for k in range(200) if k not in (50, 51, 120)]
    (series,) = plain(tmp_path, [(t, 0, 0) for t in times], unit=unit)
    assert series.stamps.tolist() == [
        START + 2_000_000 * k for k in range(200) if k not in (50, 51, 120)]


def test_nanoseconds_as_a_recorder_writes_them(tmp_path):
    first = 1_763_802_000_123_456_789
    steps = np.random.default_rng(1).integers(30_000_000, 70_000_000, 50)
    times = first + np.concatenate([[0], np.cumsum(steps)])
    (series,) = plain(tmp_path, [(int(t), 0, 0) for t in times], unit='ns')
    np.testing.assert_allclose(series.stamps - START, times - first, atol=256)   # of a double


def test_times_that_no_stamp_holds(tmp_path):
    rows = [(1_763_802_000 * 10**9 + 2_000_000 * k, 0, 0) for k in range(2000)]
    assert len(plain(tmp_path, rows, unit='ns')) == 1
    with pytest.raises(BagError, match=r'span 4e.09 s.*is the unit of the time column right'):
        plain(tmp_path, rows, unit='s')


def test_a_row_that_repeats_the_time_is_left_out_and_named(tmp_path, caplog):
    rows = [(0.01 * (k - (k > 7)), k, k) for k in range(30)]
    with caplog.at_level(logging.WARNING):
        (series,) = plain(tmp_path, rows)
    assert series['x'].tolist() == [k for k in range(30) if k != 8]
    assert '1 rows with the time of the row before are left out, the first is row 9' in caplog.text


def test_a_last_row_cut_short_is_left_out(tmp_path, caplog):
    (tmp_path / 'a.csv').write_text('t,u,x,note\n' + ''.join(
        f'{0.1 * k:.1f},1,2.5,-\n' for k in range(20)) + '2.0,1,2')
    with caplog.at_level(logging.WARNING):
        (series,) = read_tables(
            [tmp_path / 'a.csv'], table_map(tmp_path, PLAIN.replace('UNIT', 's')))
    assert series['x'].tolist() == [2.5] * 20
    assert 'the last row is cut short (3 of 4 columns)' in caplog.text


@pytest.mark.parametrize(('crop', 'left'), [
    ('rows: [11, 30]', range(10, 30)),
    ('rows: [11, null]', range(10, 50)),
    ('rows: [null, 30]', range(30)),
    ('rows: [41, 400]', range(40, 50)),
    ('time_range: [5.2, 5.4]', range(10, 21)),
    ('time_range: [null, 5.4]', range(21)),
    ('rows: [16, null]\ntime_range: [5.2, 5.4]', range(15, 21)),
])
@pytest.mark.parametrize('form', ['csv', 'mat'])
def test_rows_and_times_outside_are_not_read(tmp_path, crop, left, form):
    time, x = 5.0 + 0.02 * np.arange(50), np.arange(50.0)
    if form == 'csv':
        (tmp_path / 'a.csv').write_text('t,u,x\n' + ''.join(
            f'{t:.2f},1,{k:g}\n' for t, k in zip(time, x, strict=True)))
    else:
        savemat(tmp_path / 'a.mat', {'t': time, 'u': 1.0, 'x': x})
    text = PLAIN.replace('UNIT', 's') + crop
    (series,) = read_tables([tmp_path / f'a.{form}'], table_map(tmp_path, text))
    assert series['x'].tolist() == list(left)
    assert series.stamps.tolist() == [START + 20_000_000 * k for k in range(len(left))]


def test_what_is_cropped_need_not_be_right(tmp_path):
    """A row of units, a broken end: what is not read is not complained of."""
    (tmp_path / 'a.csv').write_text('Time [s], Valve (V) ,Position [mm]\n[s],V,mm\n' + ''.join(
        f'{0.1 * k:.1f},{k},{10 * k}\n' for k in range(20)) + '2.0,,nan\n\n2.1,oops\n')
    text = """
plant: cylinder
rows: [2, 21]
time: {column: "Time [s]"}
signals:
  command: {column: Valve (V), unit: V}
  x: {column: "Position [mm]", unit: mm}
"""
    (series,) = read_tables([tmp_path / 'a.csv'], table_map(tmp_path, text))
    assert series['command'].tolist() == list(range(20))
    np.testing.assert_allclose(series['x'], 0.01 * np.arange(20), rtol=1e-14)
    with pytest.raises(BagError, match=r'column Valve .V. .* in row 22: the cell is empty'):
        read_tables([tmp_path / 'a.csv'], table_map(tmp_path, text.replace('21', '24')))
    with pytest.raises(BagError, match='has no row 40'):
        read_tables([tmp_path / 'a.csv'], table_map(tmp_path, text.replace('[2, 21]', '[40, 50]')))
    crop = text.replace('rows: [2, 21]', 'rows: [2, 21]\ntime_range: [7, 8]')
    with pytest.raises(BagError, match=r'no rows between 7 and 8 s; its times are 0 to 1.9 s'):
        read_tables([tmp_path / 'a.csv'], table_map(tmp_path, crop))


@pytest.mark.parametrize(('given', 'unit', 'shown'), [
    ('u', '1', '1'), ('{column: u, unit: V}', '1', 'V'), ('{column: u, unit: mA}', '1', 'A'),
    ('{column: u, unit: percent}', '1', '1'), ('u', 'V', 'V'), ('{column: u, unit: mV}', 'V', 'V'),
    ('{column: u, unit: mm}', 'm', 'm'), ('{column: u, unit: rpm}', 'rad/s', 'rad/s'),
])
def test_the_unit_in_the_bag(tmp_path, given, unit, shown):
    read = table_map(tmp_path, f'plant: x\ntime: t\nsignals: {{u: {given}}}')
    assert units_in_bag(read, {'u': unit}, 'map.yaml') == {'u': shown}


@pytest.mark.parametrize(('given', 'unit', 'says'), [
    ('mm', 'rad', 'signal u: mm cannot be converted to rad; units for it are rad, deg'),
    ('N', 'N m', 'N cannot be converted to N m; units for it are N m, kN m'),
    ('percent', 'V', 'percent cannot be converted to V'),
])
def test_a_unit_of_something_else(tmp_path, given, unit, says):
    read = table_map(tmp_path, f'plant: x\ntime: t\nsignals: {{u: {{column: u, unit: {given}}}}}')
    with pytest.raises(UserError, match=says):
        units_in_bag(read, {'u': unit}, 'map.yaml')


def test_the_map_that_the_documentation_shows(tmp_path):
    page = (Path(__file__).parents[2] / 'docs' / 'recording.md').read_text(encoding='utf-8')
    (text,) = re.findall(r'```yaml\n(plant.*?)```', page, re.DOTALL)
    read = table_map(tmp_path, text)
    rows = [(1000 * k, 1 + k // 40, 2.02, 3.0, k) for k in range(100)]
    (tmp_path / 'a.csv').write_text('Time [ms],run,Valve (V),gain,sensor\n' + ''.join(
        ','.join(map(str, row)) + '\n' for row in rows))
    first, second, third = read_tables([tmp_path / 'a.csv'], read)
    assert [len(s) for s in (first, second, third)] == [27, 40, 1]   # of 13 to 80 s
    assert first['command'] == pytest.approx(2.0)
    np.testing.assert_allclose(second['x'], 20 * 3e-3 * np.arange(40, 80), rtol=1e-14)
    assert units_in_bag(read, {'command': '1', 'x': 'm'}, '') == {'command': 'V', 'x': 'm'}


@pytest.mark.parametrize(('first', 'second', 'pause'), [
    (0.0, 3600.0, 3581.0),
    (1.7e9, 1.7e9 + 50.0, 31.0),
    (0.0, 19.5, 2.0 * MAX_GAP),             # too short to be seen as one
    (0.0, 0.0, 10.0),                       # each table with a clock of its own
    (100.0, 50.0, 10.0),
    (0.0, 2.5e9, 10.0),                     # beyond what stamps can hold
])
def test_the_pause_between_tables_is_kept(tmp_path, first, second, pause):
    for name, begin in (('a.csv', first), ('b.csv', second)):
        (tmp_path / name).write_text('t,u,x\n' + ''.join(
            f'{begin + k!r},{k},{k}\n' for k in range(20)))
    read = table_map(tmp_path, PLAIN.replace('UNIT', 's'))
    one, two = read_tables([tmp_path / 'a.csv', tmp_path / 'b.csv'], read)
    assert one.stamps[0] == START
    assert (two.stamps[0] - one.stamps[-1]) * 1e-9 == pytest.approx(pause, abs=1e-6)
