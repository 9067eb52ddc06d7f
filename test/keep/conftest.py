"""The loop without ROS, for the tests of it."""
from collections.abc import Iterator
from pathlib import Path

from keep_loop import Loop
import pytest


@pytest.fixture
def loop(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Loop]:
    made = Loop(tmp_path, monkeypatch)
    yield made
    made.keeper.jobs.end(5.0)
