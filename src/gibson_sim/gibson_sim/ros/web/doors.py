"""Doors and drawers, as a page lists, opens and closes them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from sensor_msgs.msg import JointState

from gibson_sim.quoting import quoted
from gibson_sim.ros import conversions
from gibson_sim.ros.topics import names, qos
from gibson_sim.ros.web.robots import GraphNode
from gibson_sim.types import NS_PER_S
from gibson_sim.web.pages import Answer
from gibson_sim.web.requests import Open

ARRIVED = 0.02
"""Distance from the requested opening at which a joint is let go, as a part of its range."""
_AT_REST = 0.02
"""Speed below which it is, rad/s or m/s: one that moves would bounce off its stop."""
_PATIENCE_NS = 8 * NS_PER_S
"""Simulation time after which a joint that something holds back is let go, ns."""
_HANDLES = ("handle", "lever", "knob")
"""Ends of the names of joints that open nothing."""


@dataclass(slots=True)
class _Joint:
    """Where a joint is, and its limits, radians or metres."""

    position: float
    lower: float
    upper: float
    velocity: float

    @property
    def closed(self) -> float:
        """Position at which it is shut: 0, or the limit that is nearest to it."""
        return min(max(0.0, self.lower), self.upper)

    @property
    def range(self) -> float:
        """From shut to open; negative for a joint that opens the other way."""
        return max(self.upper - self.closed, self.lower - self.closed, key=abs)

    @property
    def opening(self) -> float:
        """0 = closed, 1 = as far as it goes."""
        return (self.position - self.closed) / self.range


@dataclass(slots=True)
class _Motion:
    """A joint on its way."""

    opening: float
    deadline_ns: int
    answer: Answer


class Doors:
    """The joints of bodies that have limits, but for handles.

    Subscribes:
        object_joint_states (control_msgs/DynamicJointState): where the joints are; where the package is missing, there are none.

    Publishes:
        object_joint_command (sensor_msgs/JointState): to the position, and, when it is there or held back, no effort: it swings freely again.
    """

    def __init__(self, node: GraphNode) -> None:
        self._node, self._joints = node, dict[str, _Joint]()
        self._motions: dict[str, _Motion] = {}
        self._stamp_ns = 0
        self._publisher = node.create_publisher(JointState, names.OBJECT_JOINT_COMMAND, 10)
        try:
            kind = import_module("control_msgs.msg").DynamicJointState
        except ImportError:
            return
        node.subscribe(kind, names.OBJECT_JOINT_STATES, self._on_states, qos.LATCHED)

    def listed(self, places: Mapping[str, tuple[float, float]]) -> list[dict[str, Any]]:
        """Returns what a page shows: name, opening (0 to 1), and the place of the body on the map, m. ``places``: of all entities."""
        if not self._node.count_publishers(names.OBJECT_JOINT_STATES):
            return []
        found = []
        for name, joint in self._joints.items():
            body = name.rpartition("/")[0]
            if body in places:
                x, y = places[body]
                moving = self._motions[name].opening if name in self._motions else None
                found.append({"joint": name, "opening": round(joint.opening, 2), "moving": moving, "x": x, "y": y})
        return found

    def open(self, request: Open, answer: Answer) -> None:
        """Moves a joint; answers once it is there, or held back."""
        joint = self._joints.get(request.joint)
        if joint is None:
            answer(False, f"{quoted(request.joint)} is no door or drawer of this simulation")
            return
        self._motions[request.joint] = _Motion(request.opening, self._stamp_ns + _PATIENCE_NS, answer)
        target = joint.closed + request.opening * joint.range
        self._publisher.publish(JointState(name=[request.joint], position=[target]))

    def _on_states(self, msg: Any) -> None:
        self._joints = {}
        for name, row in zip(msg.joint_names, msg.interface_values, strict=False):
            values = dict(zip(row.interface_names, row.values, strict=False))
            if name.endswith(_HANDLES) or not {"position", "lower", "upper"} <= values.keys():
                continue
            joint = _Joint(values["position"], values["lower"], values["upper"], values.get("velocity", 0.0))
            if math.isfinite(joint.opening if joint.range else math.nan):
                self._joints[name] = joint
        before, self._stamp_ns = self._stamp_ns, conversions.time_from_msg(msg.header.stamp)
        if self._stamp_ns < before:  # a reset
            self._motions.clear()
        for name, motion in list(self._motions.items()):
            self._end(name, motion)

    def _end(self, name: str, motion: _Motion) -> None:
        """Lets a joint go that has arrived, or that something holds back."""
        joint = self._joints.get(name)
        arrived = joint is not None and abs(joint.opening - motion.opening) < ARRIVED and abs(joint.velocity) < _AT_REST
        if joint is not None and not arrived and self._stamp_ns < motion.deadline_ns:
            return
        del self._motions[name]
        self._publisher.publish(JointState(name=[name], effort=[0.0]))
        if not arrived:
            place = "" if joint is None else f": it is {100.0 * joint.opening:.0f} % open"
            motion.answer(False, f"{name} is held back by something{place}")
