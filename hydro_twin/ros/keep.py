"""The ROS shell round `keep`: topics, services, parameters of the twin, diagnostics."""
from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
import json
from pathlib import Path
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String
from std_srvs.srv import Trigger

from hydro_twin.errors import UserError
from hydro_twin.keep.keeper import Keeper
from hydro_twin.keep.limits import check_names, parse
from hydro_twin.keep.settings import SETTINGS
from hydro_twin.plants import plant_named
from hydro_twin.ros.announcer import diagnostic_array
from hydro_twin.ros.keep_inputs import Inputs
from hydro_twin.ros.parameters import declare_parameters, objection
from hydro_twin.store.store import Store
from hydro_twin.store.version import Version

PERIOD = 1.0     # of the loop and of diagnostics [s]
REASON = 200     # characters of the reason for a capture: two lines of a table
ANSWER = 5.0     # how long a service may take before another try [s]


class KeepNode(Node):
    """A node beside the live twin that captures, has traced, judges, promotes and goes back.

    Whatever a message or a step raises is a line in diagnostics; the node goes on.
    """

    def __init__(self) -> None:
        super().__init__('hydro_twin_keep')
        self._plant = ''      # whose parameters may have limits, once it is known
        self.add_on_set_parameters_callback(self._on_set)
        declare_parameters(self, SETTINGS)
        if not self._get('store'):
            raise UserError("no store is given: set the parameter 'store' to a folder")
        self._plant = self._get('plant')
        self._check_limits(self._get('limits'))
        self._answer: tuple[Any, float] | None = None     # of the twin, and since when awaited
        self._name = self.get_fully_qualified_name().strip('/')
        self._event = self.create_publisher(String, '~/event', 10)
        self._diagnostics = self.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self.keeper = Keeper(Store(Path(self._get('store')).expanduser().absolute()), self._get,
                             self._announce, self._set_model)
        twin = self.resolve_topic_name(self._get('twin'))
        self._client = self.create_client(SetParameters, f'{twin}/set_parameters')
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._subscribe(String, f'{twin}/model_info', self._on_info, latched)
        self._subscribe(String, f'{twin}/model_event', self._on_event, QoSProfile(depth=100))
        self._subscribe(String, '~/capture', self._on_reason, QoSProfile(depth=10))
        self._inputs = Inputs(self, self.keeper, self._guarded, self._parameter_overrides,
                              [*filter(None, self._get('topics')), f'{twin}/model_info'])
        self._listen(self.keeper.store.champion)       # a damaged store ends the start
        for name, answer in (('capture', self._on_capture), ('promote', self._on_promote),
                             ('rollback', self._on_rollback)):
            self.create_service(Trigger, f'~/{name}', answer)
        self.create_timer(PERIOD, partial(self._guarded, self._on_tick),
                          clock=Clock(clock_type=ClockType.STEADY_TIME))

    def destroy_node(self) -> None:
        """End what runs, then the node."""
        self.keeper.jobs.end(ANSWER)
        super().destroy_node()

    def _get(self, name: str) -> Any:
        return self.get_parameter(name).value

    def _on_set(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        """Refuse what cannot be."""
        for parameter in parameters:
            if reason := objection(parameter.name, parameter.value, SETTINGS):
                return SetParametersResult(successful=False, reason=reason)
            if parameter.name == 'limits':
                try:
                    self._check_limits(parameter.value)
                except UserError as error:
                    return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _announce(self, event: str, **about: Any) -> None:
        """Say that something happened, on ~/event and in the log."""
        self._event.publish(String(data=json.dumps({'event': event, **about})))
        warned = {'failed', 'fault', 'discarded', 'rolled_back', 'worse'}
        said = ', '.join(f'{key} {value}' for key, value in about.items() if key != 'evidence')
        if event in warned:     # rclpy remembers the severity of a line of code
            self.get_logger().warning(f'{event}: {said}')
        else:
            self.get_logger().info(f'{event}: {said}')

    def _guarded(self, function: Callable[..., object], *arguments: Any) -> None:
        """Call what must not end the node, whatever it raises."""
        try:
            function(*arguments)
        except Exception as error:
            said = ' '.join(f'{type(error).__name__}: {error}'.split())
            self.keeper.fault = said
            self.get_logger().error(said, throttle_duration_sec=60.0)

    def _subscribe(self, kind: Any, topic: str, heard: Callable[[Any], object],
                   qos: QoSProfile) -> None:
        self.create_subscription(kind, topic, partial(self._guarded, heard), qos)

    # The twin

    def _on_info(self, message: String) -> None:
        """Hear what the twin runs."""
        self.keeper.informed(json.loads(message.data))

    def _on_event(self, message: String) -> None:
        """Hear what happens to the models of the twin."""
        event = json.loads(message.data)
        if event['event'] == 'refit':
            self.keeper.refit(time.monotonic_ns(), event)
        elif event['event'] == 'refused':
            self.keeper.answered(event['says'])

    def _set_model(self, path: Path) -> None:
        """Ask the twin to run a model."""
        if self._answer is not None or not self._client.service_is_ready():
            return     # the next try comes
        request = SetParameters.Request(parameters=[
            Parameter('model', value=str(path)).to_parameter_msg()])
        self._answer = self._client.call_async(request), time.monotonic()

    def _hear_answer(self) -> None:
        """Look whether the twin has answered; one that does not answer is asked again."""
        if self._answer is None:
            return
        future, since = self._answer
        if future.done():
            self._answer = None
            result = future.result().results[0]
            self.keeper.answered('' if result.successful else result.reason)
        elif time.monotonic() - since > ANSWER:
            self._client.remove_pending_request(future)
            self._answer = None

    # Requests and time

    def _on_reason(self, message: String) -> None:
        """Capture for a reason that a person gives: the service of that name has no room for it.

        One line, and no longer than `REASON`: it is kept with the bag and shown in tables.
        """
        reason = ' '.join(message.data.split())[:REASON] or 'no reason given'
        self.keeper.ask(time.monotonic_ns(), f'asked for: {reason}')

    def _on_capture(self, request: Trigger.Request, response: Trigger.Response) -> Any:
        """Capture."""
        del request
        self.keeper.ask(time.monotonic_ns(), 'asked for by ~/capture')
        left = self.keeper.capture.left(time.monotonic_ns())
        response.success = True
        response.message = f'captures, {left:.0f} s to come'
        return response

    def _on_promote(self, request: Trigger.Request, response: Trigger.Response) -> Any:
        """Promote the challenger."""
        del request
        return self._done(self.keeper.promote, 'a person, by ~/promote', response)

    def _on_rollback(self, request: Trigger.Request, response: Trigger.Response) -> Any:
        """Go back to the predecessor."""
        del request
        return self._done(self.keeper.roll_back, 'a person, by ~/rollback', response)

    def _done(self, function: Callable[[str], str], by: str, response: Any) -> Any:
        try:
            response.message = function(by)
            response.success = True
        except Exception as error:
            response.success, response.message = False, ' '.join(str(error).split())
        return response

    def _on_tick(self) -> None:
        """Do what is due, and say how things stand; what fails does not stop the rest."""
        now = time.monotonic_ns()
        for step in (partial(self._listen, self.keeper.champion),
                     self._inputs.subscribe_to_published, self._hear_answer,
                     partial(self._note_time, now), partial(self.keeper.tick, now),
                     partial(self._publish_status, now)):
            self._guarded(step)

    def _listen(self, champion: Version | None) -> None:
        """Subscribe to the inputs once a champion says of which plant.

        Raises:
            UserError: the champion, the signals or the limits do not fit.
        """
        if self._inputs.twin_inputs is None and champion is not None:
            self._inputs.listen(champion.model_file, self._get('plant'))
            self._plant = self._inputs.plant
            self._check_limits(self._get('limits'))

    def _check_limits(self, limits: Sequence[str]) -> None:
        """Refuse limits of parameters that the plant does not have, once it is known.

        Raises:
            UserError: there is one.
        """
        if self._plant:
            check_names(parse(limits), plant_named(self._plant))

    def _note_time(self, now: int) -> None:
        """Note which stamp is the newest at this steady time [ns]."""
        inputs = self._inputs.twin_inputs
        if inputs is not None and inputs.aligner.stamp > 0:
            self.keeper.note_time(now, inputs.aligner.stamp)

    def _publish_status(self, now: int) -> None:
        """Say how things stand; steady time in ns."""
        self._diagnostics.publish(diagnostic_array(
            self._name, self.get_clock().now(), self._inputs.plant, [self.keeper.status(now)]))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the node until it is stopped.

    Raises:
        UserError: the parameters or the store do not allow it.
    """
    from hydro_twin.ros.spin import run

    return run(KeepNode, lambda _: None, arguments)
