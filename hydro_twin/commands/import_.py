"""`hydro-twin import TABLE -o BAG --map FILE`: makes a bag of a CSV or MAT table."""
from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument('table', type=Path, metavar='TABLE',
                        help='a .csv, .csv.gz or .mat file')
    parser.add_argument('-o', '--output', type=Path, required=True, metavar='BAG',
                        help='the bag to make: a folder, or a single .mcap or .db3 file')
    parser.add_argument('--map', type=Path, required=True, metavar='FILE',
                        help="what the table's columns are, and in what units; "
                             'config/measured holds examples')


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Make the bag.

    Returns:
        The bag's path, plant, number of series and samples, their rate [Hz], and the least and
        the greatest value of each signal.

    Raises:
        UserError: the table or the map file is wrong, or the bag exists already.
    """
    from hydro_twin.commands.common import progress
    from hydro_twin.errors import UserError
    from hydro_twin.plants import plant_named
    from hydro_twin.recording.digest import source_of
    from hydro_twin.recording.signals import load_signals
    from hydro_twin.recording.table import load_map, read_table
    from hydro_twin.recording.write import write_recording

    table_map = load_map(args.map)
    plant = plant_named(table_map.plant)
    signals = load_signals(plant.name, [signal.name for signal in plant.signals])
    if table_map.signals.keys() != signals.keys():
        raise UserError(f'{args.map}: the signals of {plant.name} are {", ".join(signals)}, '
                        f'not {", ".join(table_map.signals)}')
    series = read_table(args.table, table_map)
    source = source_of(args.table)
    about = {'table': args.table.name, 'sha256': source.sha256, 'origin': table_map.origin}
    with progress('writing'):
        write_recording(args.output, series, signals, about)
    return {
        'bag': str(args.output),
        'plant': plant.name,
        'series': len(series),
        'samples': sum(map(len, series)),
        'rate': 1.0 / series[0].sample_time,
        'signals': {signal.name: {
            'unit': signal.unit,
            'min': min(s[signal.name].min() for s in series),
            'max': max(s[signal.name].max() for s in series)} for signal in plant.signals},
    }


def show(result: dict[str, Any], console: Console) -> None:
    """Print what the bag holds."""
    console.print(f'{result["bag"]}: {result["plant"]}, {result["samples"]} samples in '
                  f'{result["series"]} series, {result["rate"]:.6g} Hz', highlight=False)
    for name, signal in result['signals'].items():
        console.print(f'  {name}: {signal["min"]:.6g} to {signal["max"]:.6g} {signal["unit"]}',
                      highlight=False, markup=False)
