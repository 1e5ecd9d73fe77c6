"""Lists, opens and closes doors and drawers for a page."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from sensor_msgs.msg import JointState

from gibson_sim.quoting import quoted
from gibson_sim.ros import conversions
from gibson_sim.ros.topics import names, qos
from gibson_sim.ros.web.robots import GraphNode
from gibson_sim.standard.openings import BLOCKED_S, JointOpening, joint_openings
from gibson_sim.types import NS_PER_S
from gibson_sim.web.pages import Answer
from gibson_sim.web.requests import Open

_TIMEOUT_NS = round(BLOCKED_S * NS_PER_S)
"""Time after which a blocked joint is released, ns of simulation time."""


@dataclass(slots=True)
class _Motion:
    """A requested motion of a joint."""

    opening: float
    """Requested opening, 0 to 1."""
    deadline_ns: int
    answer: Answer


class Doors:
    """The joints of bodies that have limits, except handles.

    Subscribes:
        object_joint_states (control_msgs/DynamicJointState): joint states; without the package control_msgs there are no doors.

    Publishes:
        object_joint_command (sensor_msgs/JointState): the requested position, and, when it is reached or the joint is blocked, effort 0, so
            that the joint swings freely again.
    """

    def __init__(self, node: GraphNode) -> None:
        self._node, self._joints = node, dict[str, JointOpening]()
        self._motions: dict[str, _Motion] = {}
        self._stamp_ns = 0
        self._publisher = node.create_publisher(JointState, names.OBJECT_JOINT_COMMAND, 10)
        try:
            kind = import_module("control_msgs.msg").DynamicJointState
        except ImportError:
            return
        node.subscribe(kind, names.OBJECT_JOINT_STATES, self._on_states, qos.LATCHED)

    def page_values(self, places: Mapping[str, tuple[float, float, int]]) -> list[dict[str, Any]]:
        """Returns the values for the page: name, opening (0 to 1), position on the map (m) and floor of each joint.

        Args:
            places: name of each entity -> x, y, map frame, m, and the index of its floor.
        """
        if not self._node.count_publishers(names.OBJECT_JOINT_STATES):
            return []
        rows = []
        for name, joint in self._joints.items():
            body = name.rpartition("/")[0]
            if body in places:
                x, y, floor = places[body]
                moving = self._motions[name].opening if name in self._motions else None
                rows.append({"joint": name, "opening": round(joint.opening, 2), "moving": moving, "x": x, "y": y, "floor": floor})
        return rows

    def open(self, request: Open, answer: Answer) -> None:
        """Moves a joint; answers once it has reached the opening or is blocked."""
        joint = self._joints.get(request.joint)
        if joint is None:
            answer(False, f"{quoted(request.joint)} is not a door or drawer of this simulation")
            return
        self._motions[request.joint] = _Motion(request.opening, self._stamp_ns + _TIMEOUT_NS, answer)
        self._publisher.publish(JointState(name=[request.joint], position=[joint.position_at(request.opening)]))

    def _on_states(self, msg: Any) -> None:
        self._joints = joint_openings(conversions.joint_values(msg))
        previous_ns, self._stamp_ns = self._stamp_ns, conversions.time_from_msg(msg.header.stamp)
        if self._stamp_ns < previous_ns:  # a reset
            self._motions.clear()
        for name, motion in list(self._motions.items()):
            self._release_if_done(name, motion)

    def _release_if_done(self, name: str, motion: _Motion) -> None:
        """Releases a joint that has reached the requested opening, or is blocked."""
        joint = self._joints.get(name)
        arrived = joint is not None and joint.has_reached(motion.opening)
        if joint is not None and not arrived and self._stamp_ns < motion.deadline_ns:
            return
        del self._motions[name]
        self._publisher.publish(JointState(name=[name], effort=[0.0]))
        if not arrived:
            opening = "" if joint is None else f": it is {100.0 * joint.opening:.0f} % open"
            motion.answer(False, f"{name} is blocked{opening}")
