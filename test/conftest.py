"""What holds for every test."""
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


@pytest.fixture
def rig() -> Iterator[Any]:
    """Give a node of the test's own, on a ROS domain of its own; see `ros_rig.Rig`."""
    pytest.importorskip('rclpy')
    from ros_rig import running_rig

    with running_rig() as made:
        yield made
