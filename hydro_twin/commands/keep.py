"""hydro-twin keep: a node alongside the live twin that keeps its model up to date."""
from __future__ import annotations

from collections.abc import Sequence

from hydro_twin.commands.verb import RosVerb


def overview() -> str:
    """List the parameters of the node."""
    from hydro_twin.keep.settings import SETTINGS
    from hydro_twin.live.settings import overview

    return f'parameters:\n{overview(SETTINGS)}'


def main(arguments: Sequence[str]) -> int:
    """Run the node until it is stopped."""
    from hydro_twin.ros.keep import main as spin

    return spin(list(arguments))


VERB = RosVerb('keep', 'capture, trace, judge and promote models beside the live twin, a ROS 2 '
               'node (takes ROS arguments)', overview, main)
