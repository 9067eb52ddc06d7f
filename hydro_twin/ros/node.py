"""The ROS shell round the live twin: topics, parameters, lifecycle, time; no physics."""
from __future__ import annotations

from collections.abc import Callable, Sequence
import contextlib
import gc
from pathlib import Path
import time
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import ParameterException
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.timer import Timer
from std_srvs.srv import Trigger

from hydro_twin.errors import ModelError, UserError
from hydro_twin.live.diagnostics import Diagnosis
from hydro_twin.live.inputs import Feed, TwinInputs
from hydro_twin.live.models import (
    check_same_inputs,
    Choice,
    choices,
    plant_of,
    quick_refusal,
)
from hydro_twin.live.outlet import Outlet
from hydro_twin.live.worker import Worker
from hydro_twin.plants import plant_named
from hydro_twin.recording.clock import check_live
from hydro_twin.ros.announcer import Announcer
from hydro_twin.ros.lifecycle import refuse_impossible_transitions
from hydro_twin.ros.parameters import declare_parameters, objection, SignalParameters
from hydro_twin.ros.running_models import RunningModels, Settings
from hydro_twin.ros.topics import Topics

TICK = 0.05      # how often the steady timer looks for inputs that are late [s]
PERIOD = 1.0     # of the diagnostics [s]
SUCCESS, FAILURE = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE


class TwinNode(LifecycleNode):
    """A managed node: configure loads the models, activate listens and publishes.

    Messages and requests are handled by the executor; a thread loads models and publishes
    diagnostics.
    """

    def __init__(self) -> None:
        super().__init__('hydro_twin')
        refuse_impossible_transitions(self)
        self.fault: Exception | None = None   # why the last transition failed
        self._inputs: TwinInputs | None = None
        self._outlets: list[Outlet] = []
        self._restoring = False               # parameters are set to what runs already
        self._timer: Timer | None = None      # of an active node
        self._diagnosed = 0    # when that was last done, by the node's clock [ns]; 0: not yet
        self._starting = False                # by itself: who started it says what is wrong
        self._topics = Topics(self)
        self._announcer = Announcer(self)
        self._running = RunningModels(self._announcer, self.get_logger())
        self._signals = SignalParameters(self, self._parameter_overrides)
        self.add_on_set_parameters_callback(self._on_set)   # heeds what it is started with, too
        declare_parameters(self)
        self._declare_signals()
        self.add_post_set_parameters_callback(self._after_set)
        self.create_service(Trigger, '~/reset', self._on_reset)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(TICK, self._restore, clock=steady)   # in every state of the node
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
        files = ', '.join(str(choice.path) for choice in self._running.settings.chosen)
        self.get_logger().info(f'runs {files} on {", ".join(self._topics.publishers())}')
        if ignored := self._signals.ignored():
            self.get_logger().warning(f'ignores parameters that it does not know: '
                                      f'{", ".join(ignored)}')
        return super().on_activate(state)

    def _attempt(self, transition: Callable[[], None]) -> TransitionCallbackReturn:
        """Do what a transition takes; rclpy swallows whatever is raised there."""
        try:
            transition()
        except (UserError, ParameterException) as error:
            self.fault = UserError(str(error))
        except Exception as error:
            self.fault = error
        else:
            return SUCCESS
        if not self._starting:
            self.get_logger().error(str(self.fault))
        return FAILURE

    def start(self) -> None:
        """Configure and activate, as a lifecycle manager would.

        Raises:
            UserError: the models or parameters do not allow it.
        """
        self._starting = True
        for trigger in (self.trigger_configure, self.trigger_activate):
            if trigger() != SUCCESS:
                raise self.fault or UserError('the node does not start')
        self._starting = False

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
        """Stop the thread and all that is heard, then the node."""
        self._worker.stop()
        self._stop_listening()
        super().destroy_node()

    def _configure(self) -> None:
        """Make everything that an active node needs."""
        settings = Settings(tuple(self._choices()), self.get_parameter('mode').value,
                            tuple(self.get_parameter('follow').value))
        twins = self._running.load(settings)
        for twin in twins:
            check_same_inputs(twin, twins[0])
        predictor = twins[0].predictor
        plant = self.get_parameter('plant').value
        if plant not in ('', predictor.plant.name):
            raise ModelError(f'{settings.main.path}: a model of {predictor.plant.name}, but '
                             f"the parameter 'plant' is {plant}")
        check_live(self.get_parameter('sample_time').value or None, predictor.sample_time)
        signals = self._topics.resolved(self._signals.read(predictor.plant))
        self._inputs = TwinInputs(predictor.plant, signals, predictor.sample_time,
                                  self.get_parameter('wait').value)
        horizon = self.get_parameter('horizon').value
        self._outlets = [self._topics.outlet(twin, horizon) for twin in twins]
        self._diagnosed = 0
        self._running.begin(settings, Diagnosis(self._inputs, twins))
        self._announcer.info(twins)

    def _choices(self) -> list[Choice]:
        """List the models that the parameters ask for."""
        return choices(self.get_parameter('model').value, self.get_parameter('models').value)

    def _declare_signals(self) -> None:
        """Declare the signals of the plant, as soon as it is known which one that will be."""
        with contextlib.suppress(ModelError):   # which configure will refuse
            self._signals.declare(self.get_parameter('plant').value
                                  or plant_of(self._choices()[0].path))

    def _listen(self) -> None:
        """Subscribe to the inputs, start the timer."""
        inputs = self._inputs
        if inputs is None:
            raise RuntimeError('activated before it was configured')
        inputs.aligner.restart()
        inputs.begun = False
        for feed in inputs.feeds:
            self._topics.listen(feed, self._listener(inputs, feed))
        self._ticked = time.monotonic()
        self._timer = self.create_timer(TICK, self._on_tick,
                                        clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _stop_listening(self) -> None:
        if self._timer is not None:
            self.destroy_timer(self._timer)
            self._timer = None
        self._topics.stop_listening()
        gc.enable()
        gc.unfreeze()

    def _clean_up(self) -> None:
        self._stop_listening()
        self._topics.close()
        self._outlets = []
        self._inputs = None
        self._running.forget()

    # The hot path

    def _listener(self, inputs: TwinInputs, feed: Feed) -> Callable[[bytes], None]:
        """Make the callback of one topic."""
        clock = self.get_clock()

        def now() -> int:
            return int(clock.now().nanoseconds)

        def listen(payload: bytes) -> None:
            if self._running.waiting:
                self._running.swap_in(self._outlets)
            if not inputs.begun:
                inputs.begin(self._topics.publishers())
            inputs.take(feed, payload, now)
            self._drain(inputs)

        return listen

    def _drain(self, inputs: TwinInputs) -> None:
        """Step the twins through all the samples that are ready."""
        aligner = inputs.aligner
        while aligner.advance():
            for outlet in self._outlets:
                if aligner.first:
                    outlet.restart()
                outlet.step(aligner.stamp, aligner.inputs, aligner.measured, aligner.sensors)

    def _on_tick(self) -> None:
        """Fill in inputs that are late, unless it is this process that is late."""
        now = time.monotonic()
        stalled, self._ticked = now - self._ticked > 2.0 * TICK, now
        if self._inputs is not None and not stalled:
            self._inputs.tick(self.get_clock().now().nanoseconds)
            self._drain(self._inputs)

    # Requests

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Restart the predictions."""
        del request
        if self._inputs is not None:
            self._inputs.aligner.restart()
            for outlet in self._outlets:
                outlet.twin.start_over()
        response.success = self._inputs is not None
        response.message = 'restarted' if response.success else 'not configured'
        return response

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """Set what is asked for: what is so already is left as it is, even if read-only."""
        changed = [parameter for parameter in parameter_list if not self._is_so(parameter)]
        for parameter in changed:
            if reason := self._signals.unknown(parameter.name):
                return SetParametersResult(successful=False, reason=reason)
        if not changed:
            return SetParametersResult(successful=True)
        return super().set_parameters_atomically(changed)

    def _is_so(self, parameter: Parameter) -> bool:
        """Say whether setting a parameter would change nothing, in the file of a model either."""
        now = self.get_parameter_or(parameter.name)
        if not self.has_parameter(parameter.name) or now.value != parameter.value:
            return False
        return parameter.name != 'model' or not self._running.file_changed()

    def _on_set(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        """Refuse what cannot be, as far as that shows without loading anything."""
        for parameter in parameters:
            if reason := self._objection(parameter.name, parameter.value):
                return SetParametersResult(successful=False, reason=reason)
        return SetParametersResult(successful=True)

    def _objection(self, name: str, value: Any) -> str:
        """Say why a parameter cannot have a value, or ''."""
        if reason := objection(name, value):
            return reason
        if name == 'plant' and value:
            try:
                plant_named(value)
            except UserError as error:
                return str(error)
        if not self._outlets or self._restoring:
            return ''
        if name in ('models', 'plant') or name.startswith('signals.'):
            return f'{name} can be set before the node is configured: clean it up first'
        if name == 'model':
            if self._running.settings.main.name:
                return 'the node was configured without a main model'
            return quick_refusal(Path(value).expanduser(),
                                 self._outlets[0].twin.predictor.plant.name)
        return ''

    def _after_set(self, parameters: Sequence[Parameter]) -> None:
        """Act on new values."""
        values = {parameter.name: parameter.value for parameter in parameters}
        if self._inputs is None:
            if values.keys() & {'model', 'models', 'plant'}:
                self._declare_signals()
            return
        if self._restoring:
            return
        if 'wait' in values:
            self._inputs.aligner.bound_wait(values['wait'])
        if 'horizon' in values:
            for outlet in self._outlets:
                outlet.horizon = values['horizon']
        if values.keys() & {'model', 'mode', 'follow'}:
            reload = self._running.ask(*(self.get_parameter(name).value
                                         for name in ('model', 'mode', 'follow')))
            if reload is not None:
                self._worker.do(reload)

    def _restore(self) -> None:
        """Set the parameters to what runs where the newest request was refused."""
        if not self._running.refused():
            return
        settings = self._running.settings
        runs = {'mode': settings.mode, 'follow': list(settings.follow),
                **({} if settings.main.name else {'model': str(settings.main.path)})}
        self._restoring = True
        try:
            self.set_parameters([Parameter(name, value=value) for name, value in runs.items()])
        finally:
            self._restoring = False

    # Off the hot path

    def _diagnose(self, elapsed: float) -> None:
        """Judge the residuals, publish diagnostics, tidy up."""
        diagnosis = self._running.diagnosis
        if diagnosis is None:
            return
        now = self.get_clock().now()
        if self.get_parameter('use_sim_time').value and 0 < self._diagnosed < now.nanoseconds:
            elapsed = (now.nanoseconds - self._diagnosed) * 1e-9   # the bag's time
        self._diagnosed = now.nanoseconds
        self._topics.note_subscribers()
        for twin in diagnosis.twins:
            if (rise := twin.judge()) is not None:
                self._announcer.refit(twin, rise, [feed.topic for feed in diagnosis.inputs.feeds])
        statuses = diagnosis.inactive() if self._timer is None else diagnosis.statuses(
            now.nanoseconds, elapsed, self._topics.publishers())
        self._announcer.diagnostics(now, diagnosis.twins[0].predictor.plant.name, statuses)
        gc.collect()   # quick: all from before the start is frozen
