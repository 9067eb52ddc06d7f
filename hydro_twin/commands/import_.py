"""`hydro-twin import TABLE... -o BAG --map FILE`: makes a bag of CSV, MAT or NPZ tables."""
from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TYPE_CHECKING

from hydro_twin.commands.verb import Verb

if TYPE_CHECKING:
    from rich.console import Console

    from hydro_twin.recording.series import StampedSeries

EVEN = 0.01   # of a period: a spread of the periods that is not worth a line


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument('tables', nargs='+', type=Path, metavar='TABLE',
                        help='a text file (.csv, .tsv, .txt, .dat, plain or .gz), .mat or .npz; '
                             'of several, each is a series or more')
    parser.add_argument('-o', '--output', type=Path, required=True, metavar='BAG',
                        help='the bag to make: a folder, or a single .mcap or .db3 file')
    parser.add_argument('--map', type=Path, required=True, metavar='FILE',
                        help='what the columns are, in what units, and which rows to take; '
                             'config/measured holds examples')


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Make the bag.

    Returns:
        The bag's path, plant, number of tables, series and samples; the typical rate [Hz] and
        the periods of the samples [s]; unit, least and greatest value of each signal that has
        any.

    Raises:
        UserError: a table or the map file is wrong, or the bag exists already.
    """
    import numpy as np

    from hydro_twin.errors import UserError
    from hydro_twin.plants import plant_named
    from hydro_twin.progress import progress
    from hydro_twin.recording.digest import source_of
    from hydro_twin.recording.signals import load_signals
    from hydro_twin.recording.table import read_tables
    from hydro_twin.recording.table_map import load_map, units_in_bag
    from hydro_twin.recording.write import write_recording

    table_map = load_map(args.map)
    plant = plant_named(table_map.plant)
    needed, sensors = ([signal.name for signal in some]
                       for some in (plant.signals, plant.sensors))
    if not set(needed) <= table_map.signals.keys() <= {*needed, *sensors}:
        more = f', and where measured {", ".join(sensors)}' if sensors else ''
        raise UserError(f'{args.map}: the signals of {plant.name} are {", ".join(needed)}{more}, '
                        f'not {", ".join(table_map.signals)}')
    signals = {name: where for name, where in load_signals(
        plant.name, needed, optional=sensors).items() if name in table_map.signals}
    units = units_in_bag(table_map, {s.name: s.unit for s in (*plant.signals, *plant.sensors)},
                         str(args.map))
    with progress('reading', len(args.tables)) as advance:
        series = read_tables(args.tables, table_map, sensors, advance)
    _check_readable(series)
    about = {'table': ', '.join(table.name for table in args.tables),
             'sha256': ', '.join(source_of(table).sha256 for table in args.tables),
             'origin': table_map.origin}
    with progress('writing'):
        write_recording(args.output, series, signals, about)
    measured = {}
    for name, unit in units.items():
        values = np.concatenate([s[name] for s in series])
        if np.isfinite(values).any():
            measured[name] = {'unit': unit, 'min': np.nanmin(values), 'max': np.nanmax(values)}
    periods = np.concatenate([np.diff(s.stamps) for s in series]) * 1e-9
    low, typical, high = np.percentile(periods, [5, 50, 95])
    return {
        'bag': str(args.output),
        'plant': plant.name,
        'tables': len(args.tables),
        'series': len(series),
        'samples': sum(map(len, series)),
        'rate': round(1.0 / typical, 9),
        'periods': {'p5': low, 'median': typical, 'p95': high, 'longest': periods.max()},
        'signals': measured,
    }


def _check_readable(series: Sequence[StampedSeries]) -> None:
    """Refuse what would not be read from the bag as it is written.

    The reader cuts where a pause is long for the whole bag, so that the samples of a slow table
    among fast ones would all stand by themselves.

    Raises:
        BagError: no series has enough samples, or the rates of the tables differ too much.
    """
    import numpy as np

    from hydro_twin.errors import BagError
    from hydro_twin.recording.grid import MAX_GAP, MIN_SAMPLES

    if max(map(len, series)) < MIN_SAMPLES:
        raise BagError(f'{series[0].source}: no {MIN_SAMPLES} rows follow each other in time '
                       'without a gap')
    steps = [np.diff(s.stamps) for s in series]
    limit = MAX_GAP * np.median(np.concatenate(steps))
    for one, pauses in zip(series, steps, strict=True):
        if len(one) >= MIN_SAMPLES and np.median(pauses) > limit:
            raise BagError(f'{one.source} has a sample every {np.median(pauses) * 1e-9:.4g} s, '
                           'where most come so much faster that these would count as gaps: '
                           'import it to a bag of its own')


def show(result: dict[str, Any], console: Console) -> None:
    """Print what the bag holds."""
    periods = result['periods']
    console.print(f'{result["bag"]}: {result["plant"]}, {result["samples"]} samples in '
                  f'{result["series"]} series, {result["rate"]:.6g} Hz', highlight=False)
    if periods['p95'] - periods['p5'] > EVEN * periods['median']:
        console.print(f'  unevenly: nine periods of ten are {1e3 * periods["p5"]:.4g} to '
                      f'{1e3 * periods["p95"]:.4g} ms', highlight=False)
    for name, signal in result['signals'].items():
        console.print(f'  {name}: {signal["min"]:.6g} to {signal["max"]:.6g} {signal["unit"]}',
                      highlight=False, markup=False)


VERB = Verb('import', 'make a bag of CSV, MAT or NPZ tables', add_arguments, run, show)
