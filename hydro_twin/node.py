"""The ROS shell round the live twin: topics, parameters, lifecycle, time; no physics."""
from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
import gc
from pathlib import Path
import signal
import sys
import time
from typing import Any

from rcl_interfaces.msg import SetParametersResult
import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.lifecycle import (
    LifecycleNode,
    LifecyclePublisher,
    LifecycleState,
    TransitionCallbackReturn,
)
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.signals import SignalHandlerOptions
from rclpy.validate_topic_name import validate_topic_name
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from hydro_twin.announcer import Announcer
from hydro_twin.errors import ModelError, UserError
from hydro_twin.live.diagnostics import Diagnosis
from hydro_twin.live.live import Feed, Live
from hydro_twin.live.messages import message_class
from hydro_twin.live.models import Choice, choices, load_twin, same_inputs, taste
from hydro_twin.live.outlet import Outlet
from hydro_twin.live.twin import Twin
from hydro_twin.live.worker import Worker
from hydro_twin.parameters import declare_parameters, SignalParameters
from hydro_twin.predictors.predictor import MODES
from hydro_twin.recording.clock import check_live

DEPTH = 200      # messages: a hiccup of 400 ms at 500 Hz
TICK = 0.05      # how often the steady timer looks for inputs that are late [s]
PERIOD = 1.0     # of the diagnostics [s]
SWITCH = 5e-4    # for how long the other thread may keep a message waiting [s]
SUCCESS, FAILURE = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE
OVERRIDES = QoSOverridingOptions.with_default_policies()


class TwinNode(LifecycleNode):
    """A managed node: configure loads the models, activate listens and publishes.

    Messages and requests are handled by the executor; a thread loads models and publishes
    diagnostics. The two meet in a few attributes that are set whole: `_swaps`, `_restore`.
    """

    def __init__(self) -> None:
        super().__init__('hydro_twin')
        self.fault: Exception | None = None   # why the last transition failed
        self._live: Live | None = None
        self._diagnosis: Diagnosis | None = None
        self._outlets: list[Outlet] = []
        self._outgoing: list[LifecyclePublisher] = []
        self._chosen: list[Choice] = []
        self._swaps: deque[Twin] = deque()    # loaded, to take over at the next message
        self._restore: str | None = None      # the value of `model` before it was refused
        self._entities: list[tuple[Callable[[Any], Any], Any]] = []   # of an active node
        self._publisher_counts: dict[str, Callable[[], int]] = {}
        self._diagnosed = 0                   # when that was last done, by the node's clock [ns]
        self._signals = SignalParameters(self)
        self.add_on_set_parameters_callback(self._on_set)   # heeds what it is started with, too
        declare_parameters(self)
        self.add_post_set_parameters_callback(self._after_set)
        self._announcer = Announcer(self)
        self.create_service(Trigger, '~/reset', self._on_reset)
        self._worker = Worker(PERIOD, self._diagnose, lambda error: self.get_logger().error(
            f'off the hot path: {error!r}', throttle_duration_sec=60.0))

    # Lifecycle

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Load and check the models, create what they publish."""
        del state
        done = self._attempt(self._configure)
        if done != SUCCESS:
            self._clean_up()
        return done

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Listen."""
        done = self._attempt(self._listen)
        if done != SUCCESS:
            self._stop_listening()
            return done
        gc.collect()
        gc.freeze()
        gc.disable()   # the worker collects
        self.get_logger().info(f'runs {", ".join(str(choice.path) for choice in self._chosen)} on '
                               f'{", ".join(self._publisher_counts)}')
        return super().on_activate(state)

    def _attempt(self, transition: Callable[[], None]) -> TransitionCallbackReturn:
        """Do what a transition takes; rclpy swallows whatever is raised there."""
        try:
            transition()
        except (UserError, ParameterException, NameValidationException) as error:
            self.fault = UserError(str(error))
        except Exception as error:
            self.fault = error
        else:
            return SUCCESS
        self.get_logger().error(str(self.fault))
        return FAILURE

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop listening."""
        self._stop_listening()
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forget the models."""
        del state
        self._clean_up()
        return SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop listening, forget the models."""
        return self.on_cleanup(state)

    def destroy_node(self) -> None:
        """Stop the thread, then the node."""
        self._worker.stop()
        super().destroy_node()

    def _configure(self) -> None:
        """Make everything that an active node needs."""
        self._chosen = choices(self.get_parameter('model').value,
                               self.get_parameter_or('models').value or ())
        mode = self.get_parameter('mode').value
        twins = [load_twin(choice, mode) for choice in self._chosen]
        for twin in twins:
            same_inputs(twin, twins[0])
        predictor = twins[0].predictor
        check_live(self.get_parameter_or('sample_time').value, predictor.sample_time)
        signals = self._signals.read(predictor.plant)
        for where in signals.values():
            message_class(where.type)
            validate_topic_name(where.topic)
        self._live = Live(predictor.plant, signals, predictor.sample_time,
                          self.get_parameter('wait').value)
        self._outlets = [self._outlet(twin) for twin in twins]
        self._diagnosis = Diagnosis(self._live, twins)
        self._announcer.info(twins)

    def _outlet(self, twin: Twin) -> Outlet:
        """Create the topics of a twin."""
        prefix = f'~/{twin.name}/' if twin.name else '~/'
        prediction, residual = (
            self.create_lifecycle_publisher(
                JointState, f'{prefix}{topic}', QoSProfile(depth=DEPTH),
                qos_overriding_options=OVERRIDES)
            for topic in ('prediction', 'residual'))
        self._outgoing += [prediction, residual]
        return Outlet(twin, prediction.publish, residual.publish)

    def _listen(self) -> None:
        """Subscribe to the inputs, start the timer."""
        live = self._live
        if live is None:
            raise RuntimeError('activated before it was configured')
        live.aligner.restart()
        for feed in live.feeds:
            subscription = self.create_subscription(
                message_class(feed.type), feed.topic, self._listener(live, feed),
                QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT), raw=True,
                qos_overriding_options=OVERRIDES)
            self._publisher_counts[feed.topic] = subscription.get_publisher_count
            self._entities.append((self.destroy_subscription, subscription))
        self._ticked = time.monotonic()
        timer = self.create_timer(TICK, self._on_tick,
                                  clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._entities.append((self.destroy_timer, timer))

    def _stop_listening(self) -> None:
        self._publisher_counts.clear()
        for destroy, entity in self._entities:
            destroy(entity)
        self._entities.clear()
        gc.enable()
        gc.unfreeze()

    def _clean_up(self) -> None:
        self._stop_listening()
        for publisher in self._outgoing:
            self.destroy_lifecycle_publisher(publisher)
        self._outgoing.clear()
        self._outlets = []
        self._live = None
        self._diagnosis = None
        self._swaps.clear()

    # The hot path

    def _listener(self, live: Live, feed: Feed) -> Callable[[bytes], None]:
        """Make the callback of one topic."""
        clock = self.get_clock()

        def now() -> int:
            return int(clock.now().nanoseconds)

        def listen(payload: bytes) -> None:
            if self._swaps:
                self._swap()
            live.take(feed, payload, now)
            self._drain(live)

        return listen

    def _drain(self, live: Live) -> None:
        """Step the twins through all the samples that are ready."""
        aligner = live.aligner
        while aligner.advance():
            for outlet in self._outlets:
                if aligner.first:
                    outlet.restart()
                outlet.step(aligner.stamp, aligner.inputs, aligner.measured)

    def _swap(self) -> None:
        """Let freshly loaded twins take over, between two samples."""
        while self._swaps:
            twin = self._swaps.popleft()
            for outlet in self._outlets:
                if outlet.twin.name == twin.name:
                    outlet.exchange(twin)

    def _on_tick(self) -> None:
        """Fill in inputs that are late, unless it is this process that is late."""
        now = time.monotonic()
        stalled, self._ticked = now - self._ticked > 2.0 * TICK, now
        if self._live is not None and not stalled:
            self._live.tick(self.get_clock().now().nanoseconds)
            self._drain(self._live)
        if self._restore is not None:
            self.set_parameters([Parameter('model', value=self._restore)])
            self._restore = None

    # Requests

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Start afresh."""
        del request
        if self._live is not None:
            self._live.aligner.restart()
            for outlet in self._outlets:
                outlet.twin.start_over()
        response.success = self._live is not None
        response.message = 'starts afresh' if response.success else 'not configured'
        return response

    def _on_set(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        """Refuse what cannot be, as far as that shows in no time."""
        for parameter in parameters:
            if reason := self._objection(parameter.name, parameter.value):
                return SetParametersResult(successful=False, reason=reason)
        return SetParametersResult(successful=True)

    def _objection(self, name: str, value: Any) -> str:
        """Say why a parameter cannot have a value, or ''."""
        if name == 'mode' and value not in MODES:
            return f'mode {value!r}: there are {" and ".join(MODES)}'
        if not self._outlets or self._restore is not None:
            return ''
        if name == 'models' or name.startswith('signals.'):
            return f'{name} can be set before the node is configured: clean it up first'
        if name == 'model':
            if self._chosen[0].name:
                return 'the node was configured without a main model'
            return taste(Path(value).expanduser(), self._outlets[0].twin.predictor.plant.name)
        return ''

    def _after_set(self, parameters: Sequence[Parameter]) -> None:
        """Act on new values."""
        values = {parameter.name: parameter.value for parameter in parameters}
        if self._live is None or self._restore is not None:
            return
        if 'wait' in values:
            self._live.aligner.bound_wait(values['wait'])
        if 'model' in values or 'mode' in values:
            model = self._chosen[0].path if 'model' not in values else values['model']
            self._worker.do(partial(self._reload, Path(model).expanduser(),
                                    self.get_parameter('mode').value))

    # Off the hot path

    def _reload(self, model: Path, mode: str) -> None:
        """Load what has changed to take over from what runs, or leave that running."""
        first, *others = self._chosen
        chosen = [Choice(first.name, model), *others]
        diagnosis = self._diagnosis
        if diagnosis is None:
            return   # cleaned up meanwhile
        try:
            changed = chosen if mode != diagnosis.twins[0].mode else chosen[:1]
            twins = [load_twin(choice, mode) for choice in changed]
            same_inputs(twins[0], diagnosis.twins[0])
        except ModelError as error:
            self.get_logger().error(f'refused, the model before it still runs: {error}')
            self._announcer.event('refused', says=str(error))
            self._restore = str(first.path)
            return
        self._chosen = chosen
        self._swaps.extend(twins)
        running = {twin.name: twin for twin in [*diagnosis.twins, *twins]}
        self._diagnosis = Diagnosis(diagnosis.live, list(running.values()))
        self._announcer.info(self._diagnosis.twins)
        self._announcer.event('swapped', model=str(model), mode=mode)
        self.get_logger().info(f'{model} takes over, {mode}')

    def _diagnose(self, elapsed: float) -> None:
        """Judge the residuals, publish diagnostics, tidy up."""
        diagnosis = self._diagnosis
        if diagnosis is None:
            return
        now = self.get_clock().now()
        if self.get_parameter('use_sim_time').value and now.nanoseconds > self._diagnosed:
            elapsed = (now.nanoseconds - self._diagnosed) * 1e-9   # the bag's time
        self._diagnosed = now.nanoseconds
        for twin in diagnosis.twins:
            if twin.monitor is not None and (rise := twin.monitor.judge()) is not None:
                self._announcer.event(
                    'refit', model=twin.name, begin=rise.begin, end=rise.end, rms=rise.rms,
                    promised=rise.promised, topics=[feed.topic for feed in diagnosis.live.feeds])
        self._announcer.diagnostics(now, diagnosis.statuses(
            now.nanoseconds, elapsed, {topic: count() for topic, count in
                                       list(self._publisher_counts.items())}))
        gc.collect()   # quick: all from before the start is frozen


def make_executor() -> Executor:
    """Take the executor that costs a message a sixth of the other, where this rclpy has it."""
    try:
        from rclpy.experimental.events_executor import EventsExecutor
    except ImportError:
        return SingleThreadedExecutor()
    return EventsExecutor()


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the node until it is shut down.

    Args:
        arguments: ROS arguments; by default those of this process.

    Raises:
        UserError: it starts itself, and the models or parameters do not allow it.
    """
    stopped = False

    def stop(*_: object) -> None:
        nonlocal stopped
        stopped = True

    # An exception in a callback would abort the EventsExecutor, so no signal may raise one; and
    # rclpy's own handlers would end the context while the node still starts.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop)
    try:
        rclpy.init(args=None if arguments is None else [sys.argv[0], *arguments],
                   signal_handler_options=SignalHandlerOptions.NO)
        node = TwinNode()
    except (RuntimeError, ParameterException) as error:   # rcl's errors are of the former
        rclpy.try_shutdown()
        raise UserError(str(error)) from error
    sys.setswitchinterval(SWITCH)
    try:
        if node.get_parameter('autostart').value:
            for trigger in (node.trigger_configure, node.trigger_activate):
                if trigger() != SUCCESS:
                    raise node.fault or UserError('the node does not start')
        executor = make_executor()
        executor.add_node(node)
        # spin() of some EventsExecutors hangs under full load; spin_once() does not.
        while not stopped:
            executor.spin_once(timeout_sec=0.2)
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    return 0


if __name__ == '__main__':
    sys.exit(main())
