"""Starts the node as a process, and spins it until it is stopped."""
from __future__ import annotations

from collections.abc import Callable, Sequence
import sys

import rclpy
from rclpy.exceptions import ParameterException
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from hydro_twin.errors import UserError
from hydro_twin.ros.node import TwinNode
from hydro_twin.stopping import listen, requested

SWITCH = 5e-4    # for how long the other thread may keep a message waiting [s]


def make_executor() -> Executor:
    """Return an EventsExecutor where this rclpy has one, else a SingleThreadedExecutor.

    It costs a sixth of the other per message.
    """
    try:
        from rclpy.experimental.events_executor import EventsExecutor
    except ImportError:
        return SingleThreadedExecutor()
    return EventsExecutor()


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the live twin until it is shut down.

    Args:
        arguments: ROS arguments; by default those of this process.

    Raises:
        UserError: it starts itself, and the models or parameters do not allow it.
    """
    return run(TwinNode, lambda node: node.start() if node.get_parameter('autostart').value
               else None, arguments)


def run[N: Node](make: Callable[[], N], start: Callable[[N], object],
                 arguments: Sequence[str] | None) -> int:
    """Run a node until the process is stopped.

    Args:
        make: makes it, once there is a context.
        start: called with it before it is spun.
        arguments: ROS arguments; None: those of this process.

    Raises:
        UserError: the parameters do not allow it.
    """
    listen()
    try:
        # rclpy's own handlers would end the context while the node still starts.
        rclpy.init(args=None if arguments is None else [sys.argv[0], *arguments],
                   signal_handler_options=SignalHandlerOptions.NO)
        node = make()
    except (RuntimeError, ParameterException, UserError) as error:   # rcl's are RuntimeErrors
        rclpy.try_shutdown()
        raise UserError(str(error)) from error
    sys.setswitchinterval(SWITCH)
    try:
        start(node)
        executor = make_executor()
        executor.add_node(node)
        # spin() of some EventsExecutors hangs under full load; spin_once() does not.
        while not requested():
            executor.spin_once(timeout_sec=0.2)
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    return 0


if __name__ == '__main__':
    sys.exit(main())
