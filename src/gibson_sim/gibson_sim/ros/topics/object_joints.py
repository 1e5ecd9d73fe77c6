"""Joints of bodies, such as doors and drawers: publishes their positions and limits, and applies commands."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from importlib import import_module
from typing import Any

from rclpy.node import Node
from sensor_msgs.msg import JointState

from gibson_sim.description.urdf_model import UrdfJoint
from gibson_sim.errors import CommandError
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.quoting import quoted
from gibson_sim.robots.joints.commands import JointCommand, JointEfforts
from gibson_sim.ros import conversions
from gibson_sim.ros.lockstep.journal import Journal
from gibson_sim.ros.topics import names, qos
from gibson_sim.sensors.schedule import is_due

RATE_HZ = 10
"""Rate of ``object_joint_states``, Hz of simulation time."""


class ObjectJoints:
    """Publishes the joints of all bodies, and applies commands to them. A joint is named ``<body>/<joint>``.

    Subscribes:
        object_joint_command (sensor_msgs/JointState): with positions, joints move to them and are held there; efforts, if any, are then
            effort limits (0 = the joint's limit). With velocities alone, joints move at them. With efforts alone, these are applied; 0 = the
            joint swings freely.

    Publishes, latched:
        object_joint_states (control_msgs/DynamicJointState) at 10 Hz while it has subscribers, and at every change of the scene:
            ``position``, ``velocity`` and, if the joint has limits, ``lower`` and ``upper`` of each joint, rad or m.
    """

    def __init__(self, node: Node, publish_hz: int, on_received: Callable[[str], None]) -> None:
        """Creates the topics; ``publish_hz`` is the rate of ticks, ``on_received`` is called with the topic of each command."""
        self._node, self._publish_hz, self._on_received = node, publish_hz, on_received
        self._topic = node.resolve_topic_name(names.OBJECT_JOINT_COMMAND)
        self._received: deque[Any] = deque(maxlen=qos.MAX_COMMANDS)
        self._due: deque[Any] = deque(maxlen=qos.MAX_COMMANDS)
        node.create_subscription(JointState, names.OBJECT_JOINT_COMMAND, self._on_command, qos.COMMAND)
        self._messages: Any = None
        self._publisher: Any = None
        try:
            self._messages = import_module("control_msgs.msg")
        except ImportError:
            node.get_logger().info(
                f"no package control_msgs here: {names.OBJECT_JOINT_STATES} is not published; install ros-jazzy-control-msgs, or build "
                "and source ros_ws, which has control_msgs"
            )
        else:
            state = self._messages.DynamicJointState
            self._publisher = node.create_publisher(state, names.OBJECT_JOINT_STATES, **qos.overridable(qos.LATCHED))

    @property
    def command_topics(self) -> frozenset[str]:
        """Full names of the command topics."""
        return frozenset((self._topic,))

    def _on_command(self, msg: JointState) -> None:
        self.receive_command(self._topic, msg)
        self._on_received(self._topic)

    def receive_command(self, topic: str, msg: Any) -> None:
        """Appends a command to the queue of received commands, as if it had arrived on ``topic``."""
        del topic
        self._received.append(msg)

    def latch_commands(self) -> None:
        """Makes all commands received so far due at the next step."""
        self._due.extend(self._received)
        self._received.clear()

    def apply_commands(self, world: PhysicsWorld, journal: Journal) -> None:
        """Applies the due commands in the order of their arrival, and records them in the journal."""
        while self._due:
            msg = self._due.popleft()
            journal.record(self._topic, msg)
            try:
                for body, command in commands_by_body(msg).items():
                    if body in {robot.name for robot in world.scene.robots}:
                        raise CommandError(
                            f"{quoted(body)} is a robot: command its joints on its own topic {names.JOINT_COMMAND}"
                        )
                    world.command_joints(body, command)
            except CommandError as error:
                self._node.get_logger().warning(str(error), throttle_duration_sec=1.0)

    def reset(self) -> None:
        """Drops all commands: the simulation was reset."""
        self._received.clear()
        self._due.clear()

    def publish(self, world: PhysicsWorld, tick: int | None = None) -> None:
        """Publishes the joint states if they are due at ``tick``, which counts at ``publish_hz``; None = the scene has changed."""
        if self._publisher is None:
            return
        rate = min(RATE_HZ, self._publish_hz)
        if tick is None or (self._publisher.get_subscription_count() and is_due(tick, rate, self._publish_hz)):
            self._publisher.publish(self._message(world))

    def _message(self, world: PhysicsWorld) -> Any:
        msg = self._messages.DynamicJointState(header=conversions.header_to_msg(world.stamp_ns, ""))
        for body in world.scene.bodies:
            movable = {joint.name: joint for joint in body.model.joints if joint.has_motor}
            if not movable:
                continue
            states = world.joint_states(body.name)
            rows = zip(states.names, states.positions.tolist(), states.velocities.tolist(), strict=True)
            for name, position, velocity in rows:
                if name in movable:
                    msg.joint_names.append(f"{body.name}/{name}")
                    msg.interface_values.append(self._interface(movable[name], position, velocity))
        return msg

    def _interface(self, joint: UrdfJoint, position: float, velocity: float) -> Any:
        values = {"position": position, "velocity": velocity}
        if joint.is_bounded:
            values |= {"lower": joint.lower, "upper": joint.upper}
        return self._messages.InterfaceValue(interface_names=list(values), values=list(values.values()))


def commands_by_body(msg: JointState) -> dict[str, JointCommand]:
    """Returns body -> command for its joints.

    Raises:
        CommandError: a name is not ``<body>/<joint>``, or the command is invalid.
    """
    rows_by_body: dict[str, list[int]] = {}
    for row, name in enumerate(msg.name):
        body, slash, joint = name.rpartition("/")
        if not (body and slash and joint):
            raise CommandError(
                f"joint {quoted(name)} of {names.OBJECT_JOINT_COMMAND} must be <body>/<joint>, such as front_door/hinge"
            )
        rows_by_body.setdefault(body, []).append(row)
    return {body: _command(msg, rows) for body, rows in rows_by_body.items()}


def _command(msg: JointState, rows: list[int]) -> JointCommand:
    joints = tuple(msg.name[row].rpartition("/")[2] for row in rows)
    columns = {key: list(getattr(msg, key)) for key in ("position", "velocity", "effort")}
    for key, values in columns.items():
        if values and len(values) != len(msg.name):
            raise CommandError(
                f"{names.OBJECT_JOINT_COMMAND} has {len(values)} values of {key} for {len(msg.name)} joints; send one for each, or none"
            )
    selected = {key: [values[row] for row in rows] if values else [] for key, values in columns.items()}
    if selected["effort"] and not selected["position"] and not selected["velocity"]:
        return JointEfforts(tuple(selected["effort"]), joints)
    return conversions.joint_command_from_msg(JointState(name=joints, **selected))
