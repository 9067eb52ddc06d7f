"""Refusal of transitions that a lifecycle node does not have in its state."""
from __future__ import annotations

from lifecycle_msgs.srv import ChangeState
from rclpy.lifecycle import LifecycleNode


def refuse_impossible_transitions(node: LifecycleNode) -> None:
    """Refuse transitions that the node's state does not have, such as activating an active node.

    rclpy checks those that are asked for by label. For one by id, as lifecycle managers ask, it
    raises in the callback, which ends the process.
    """
    service = next(s for s in node.services if s.srv_name.endswith('/change_state'))
    change = service.callback

    def on_change(request: ChangeState.Request, response: ChangeState.Response
                  ) -> ChangeState.Response:
        try:
            return change(request, response)
        except RuntimeError as error:   # rcl's are RuntimeErrors
            node.get_logger().error(f'transition {request.transition.id} refused: {error}')
            response.success = False
            return response

    service.callback = on_change
