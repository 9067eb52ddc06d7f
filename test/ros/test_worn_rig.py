"""The simulated rig that wears, and the player: what is refused before anything is published."""
from __future__ import annotations

from pathlib import Path
import signal

import pytest

pytest.importorskip('rclpy')

from ros_rig import own_domain  # noqa: E402
from rosbags.rosbag2 import StoragePlugin, Writer  # noqa: E402
from rosbags.typesys import get_typestore, Stores  # noqa: E402

from hydro_twin.errors import UserError  # noqa: E402
from hydro_twin.ros import player, worn_rig  # noqa: E402

# What rclpy imports imports what is out of date.
pytestmark = pytest.mark.filterwarnings("ignore:module 'sre_")


def test_the_rig_wears_twice_at_most(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as left:
        worn_rig.main(['--at', '1', '2', '3'])
    assert left.value.code == 2
    assert '--at takes at most two times' in capsys.readouterr().err


def test_a_bag_without_messages_is_not_played_in_a_loop(tmp_path: Path,
                                                        monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(signal, 'signal', lambda *_: None)     # those of pytest stay
    with Writer(tmp_path / 'bag', version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        writer.add_connection('/a', 'std_msgs/msg/String',
                              typestore=get_typestore(Stores.ROS2_JAZZY))
    with own_domain(), pytest.raises(UserError, match='has no messages'):
        player.play(tmp_path / 'bag', loop=True)
