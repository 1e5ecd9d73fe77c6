"""``gibson-sim action``: list, send_goal."""

from __future__ import annotations

import math
from typing import Any

from action_msgs.srv import CancelGoal
from rclpy.action import ActionClient
from rclpy.action.graph import get_action_names_and_types

from gibson_sim.errors import GibsonSimError
from gibson_sim.quoting import quoted
from gibson_sim.ros.tools.arguments import interface_class, parse_values
from gibson_sim.ros.tools.hints import PHYSICS, suggestion
from gibson_sim.ros.tools.output import print_error, print_line, print_names, with_types
from gibson_sim.ros.tools.tool import PATIENCE_S, Tool
from gibson_sim.ros.tools.yaml_messages import fill, yaml_text

_STATUS = {4: "SUCCEEDED", 5: "CANCELED", 6: "ABORTED"}


def action_list(tool: Tool, types: bool = False) -> None:
    """Prints the names of all actions, one per line."""
    tool.discover(PHYSICS)
    print_names(tool, with_types(_known_actions(tool), types))


def action_send_goal(tool: Tool, action: str, type: str, values: str = "", feedback: bool = False) -> int:
    """Sends a goal, waits for its end, and prints its result; returns 1 if it did not succeed. Ctrl-C cancels the goal."""
    kind = interface_class(type, "action")
    goal = fill(kind.Goal(), parse_values(values))
    name = tool.resolve_topic_name(action)
    if not tool.wait_for(f"the action {quoted(name)}", lambda: name in _known_actions(tool)):
        raise _missing_action(tool, name)
    # Checked before the client exists: the graph contains the types of clients, too.
    if type not in (offered := _known_actions(tool)[name]):
        raise GibsonSimError(f"{name} has the type {', '.join(offered)}, not {type}")
    client = ActionClient(tool, kind, name)
    if not tool.spin_until(PATIENCE_S, client.server_is_ready):
        raise _missing_action(tool, name)
    print_line(f"Sending goal:\n{yaml_text(goal, whole=True)}")
    on_feedback = (lambda message: print_line("Feedback:\n" + yaml_text(message.feedback))) if feedback else None
    acceptance = client.send_goal_async(goal, feedback_callback=on_feedback)
    try:
        tool.spin_until(60.0, acceptance.done)
        handle = acceptance.result() if acceptance.done() else None
        if handle is None or not handle.accepted:
            raise GibsonSimError(f"the goal was not accepted by {action}")
        future = handle.get_result_async()
        tool.spin_until(math.inf, future.done)
    except KeyboardInterrupt:
        _cancel(tool, action, acceptance)
        raise
    result = future.result()
    print_line(
        f"Result:\n{yaml_text(result.result, whole=True)}\nGoal finished with status: {_STATUS.get(result.status, result.status)}"
    )
    client.destroy()
    return 0 if result.status == 4 else 1


def _known_actions(tool: Tool) -> dict[str, list[str]]:
    """Returns action -> types of the graph."""
    return dict(get_action_names_and_types(tool))


def _missing_action(tool: Tool, name: str) -> GibsonSimError:
    """Returns the error for an action that no node offers; ``name`` is its full name."""
    hint = suggestion(name, _known_actions(tool), tool.hint("action list"))
    return GibsonSimError(f"no node offers the action {quoted(name)}; {hint}")


def _cancel(tool: Tool, action: str, acceptance: Any) -> None:
    """Cancels a goal, and prints whether that succeeded; ``acceptance`` is the future with the handle of the goal."""
    if not tool.spin_to_the_end(PATIENCE_S, acceptance.done):
        print_error(f"{action} has not accepted the goal within {PATIENCE_S:g} s: it cannot be canceled, and may be executed")
        return
    handle = acceptance.result()
    if not handle.accepted:
        return
    response = handle.cancel_goal_async()
    print_line("Canceling goal...")
    if not tool.spin_to_the_end(PATIENCE_S, response.done):
        print_error(f"{action} has not answered within {PATIENCE_S:g} s: the goal may continue")
    elif response.result().goals_canceling:
        print_line("Goal canceled.")
    elif response.result().return_code == CancelGoal.Response.ERROR_GOAL_TERMINATED:
        print_error("the goal has ended already")
    else:
        print_error(f"{action} refuses to cancel the goal: it continues")
