"""What holds for every test."""
from collections import Counter
from collections.abc import Iterator
import os
from typing import Any

from hypothesis import settings
import pytest

# No test is timed; and the small matrices here gain nothing from threads of BLAS.
settings.register_profile('untimed', deadline=None)
settings.load_profile('untimed')
os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')
os.environ.setdefault('OMP_NUM_THREADS', '1')


@pytest.hookimpl(trylast=True)   # when those that are not to run have been taken out
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the files of most slow tests, so that no worker is left with one at the end."""
    slow = Counter(item.path for item in items if item.get_closest_marker('slow'))
    size = Counter(item.path for item in items)
    items.sort(key=lambda item: (-slow[item.path], -size[item.path], item.path))


@pytest.fixture
def rig() -> Iterator[Any]:
    """Give a node of the test's own, on a ROS domain of its own; see `ros_rig.Rig`."""
    pytest.importorskip('rclpy')
    from ros_rig import running_rig

    with running_rig() as made:
        yield made
