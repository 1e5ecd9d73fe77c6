"""The topics, the service and the actions of a robot's arms, and the robot's collision counts."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

from geometry_msgs.msg import TwistStamped
from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool
from std_srvs.srv import SetBool
from trajectory_msgs.msg import JointTrajectory

from gibson_msgs.msg import CollisionCount, GraspState
from gibson_sim.errors import CommandError, PhysicsError
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.quoting import quoted
from gibson_sim.robots.spec import ManipulatorSpec, RobotSpec
from gibson_sim.ros import conversions
from gibson_sim.ros.lockstep.digest_publisher import DigestPublisher
from gibson_sim.ros.lockstep.journal import Journal
from gibson_sim.ros.services.deferred import DeferredResponse, DeferredService
from gibson_sim.ros.topics import names, qos
from gibson_sim.ros.topics.arm_actions import GripperAction, OnApplied, TrajectoryAction, control_actions, control_msgs_missing

_MAX_COMMANDS = 64
"""Maximum length of the queue of received commands; beyond it the oldest is dropped."""

_RESET = "the simulation was reset"


class _Command(NamedTuple):
    topic: str
    message: Any
    on_applied: OnApplied | None


class _Route(NamedTuple):
    apply: Callable[[PhysicsWorld, Any], None]
    joints: tuple[str, ...]
    """Joints that its commands move."""


class ArmInterface:
    """Applies the commands of a robot's arms, and publishes their grasp states. All names are relative to the robot's namespace.

    If a robot has several arms, ``grasp`` and ``grasp_state`` are ``<arm>/grasp`` and ``<arm>/grasp_state``, and ``gripper_controller`` is
    ``<arm>_gripper_controller``.

    Subscribes:
        <arm>_controller/joint_trajectory and gripper_controller/joint_trajectory (trajectory_msgs/JointTrajectory): as the robot's
            ``joint_trajectory``, for the joints of the controller only; an empty one stops them.
        gripper_controller/joint_command (sensor_msgs/JointState): positions of its joints, and their effort limits as efforts.
        <arm>_servo/delta_twist_cmds (geometry_msgs/TwistStamped): velocity of the tool, in the axes of a link of the robot.
        grasp (std_msgs/Bool): grasp or release.

    Services:
        grasp (std_srvs/SetBool): grasp or release, with the outcome.

    Actions, if control_msgs is installed:
        <arm>_controller/follow_joint_trajectory (control_msgs/FollowJointTrajectory).
        gripper_controller/gripper_cmd (control_msgs/GripperCommand).

    Publishes, while it has subscribers:
        grasp_state (gibson_msgs/GraspState), collisions (gibson_msgs/CollisionCount): at every tick.
    """

    def __init__(self, node: Node, robot: RobotSpec, on_received: Callable[[str], None], now_ns: int) -> None:
        """Creates the topics; ``on_received`` is called with the topic of each command, ``now_ns`` is simulation time, ns."""
        self._node, self._robot, self._on_received, self._now_ns = node, robot, on_received, now_ns
        self._received_commands: deque[_Command] = deque()
        self._due_commands: deque[_Command] = deque()
        self._routes: dict[str, _Route] = {}
        self._subscriptions: list[Any] = []
        self._services: list[DeferredService] = []
        self._grasp_pubs: dict[str, Publisher] = {}
        self._trajectories: list[TrajectoryAction] = []
        self._grippers: list[GripperAction] = []
        self._collisions_pub = node.create_publisher(CollisionCount, self._topic(names.COLLISIONS), **qos.overridable(qos.STATE))
        actions, missing = control_actions(), []
        for arm in robot.manipulators:
            missing += self._add_arm(arm, "" if len(robot.manipulators) == 1 else f"{arm.name}/", actions)
        if missing:
            node.get_logger().warning(control_msgs_missing(missing))
        self.command_topics = frozenset(self._routes)
        """Resolved names of all command topics."""

    def _topic(self, name: str) -> str:
        return f"{self._robot.namespace}/{name}" if self._robot.namespace else name

    def _add_arm(self, arm: ManipulatorSpec, prefix: str, actions: Any | None) -> list[str]:
        """Creates the topics and actions of one arm; returns the names of the actions that are missing without control_msgs."""
        follow = self._topic(names.controller(arm.name, "follow_joint_trajectory"))
        trajectory = names.controller(arm.name, names.JOINT_TRAJECTORY)
        self._subscribe(JointTrajectory, trajectory, partial(self._apply_trajectory, arm.joints), arm.joints)
        self._subscribe(TwistStamped, names.servo(arm.name), partial(self._apply_servo, arm.name), arm.joints)
        if actions is not None:
            action = TrajectoryAction(
                self._node,
                actions.FollowJointTrajectory,
                follow,
                self._resolved(trajectory),
                arm.joints,
                self._send,
                lambda: self._now_ns,
            )
            self._trajectories.append(action)
        if arm.gripper is None:
            return [] if actions is not None else [follow]
        gripper, joints = f"{prefix.replace('/', '_')}gripper", arm.gripper.joints
        command, grasp = names.controller(gripper, names.JOINT_COMMAND), f"{prefix}{names.GRASP}"
        gripper_trajectory = names.controller(gripper, names.JOINT_TRAJECTORY)
        self._subscribe(JointTrajectory, gripper_trajectory, partial(self._apply_trajectory, joints), joints)
        self._subscribe(JointState, command, partial(self._apply_joints, joints), joints)
        self._subscribe(Bool, grasp, partial(self._apply_grasp, arm.name), ())
        self._grasp_pubs[arm.name] = self._node.create_publisher(
            GraspState, self._topic(f"{prefix}{names.GRASP_STATE}"), **qos.overridable(qos.STATE)
        )
        self._services.append(
            DeferredService(self._node, SetBool, self._topic(grasp), partial(self._on_grasp, arm.name, self._resolved(grasp)))
        )
        grip = self._topic(names.controller(gripper, "gripper_cmd"))
        if actions is None:
            return [follow, grip]
        self._grippers.append(
            GripperAction(self._node, actions.GripperCommand, grip, self._resolved(command), joints, self._send)
        )
        return []

    def _resolved(self, name: str) -> str:
        return self._node.resolve_topic_name(self._topic(name))

    def _subscribe(self, kind: type[Any], name: str, apply: Callable[[PhysicsWorld, Any], None], joints: tuple[str, ...]) -> None:
        topic = self._resolved(name)
        self._routes[topic] = _Route(apply, joints)
        self._subscriptions.append(
            self._node.create_subscription(kind, self._topic(name), partial(self._on_command, topic), qos.COMMAND)
        )

    # Commands

    def _on_command(self, topic: str, msg: Any) -> None:
        self.receive_command(topic, msg)
        self._on_received(topic)

    def receive_command(self, topic: str, msg: Any) -> None:
        """Appends a command to the queue of received commands, as if it had arrived on ``topic``."""
        self._enqueue(_Command(topic, msg, None))

    def _send(self, topic: str, msg: Any, on_applied: OnApplied) -> None:
        self._enqueue(_Command(topic, msg, on_applied))

    def _enqueue(self, command: _Command) -> None:
        while len(self._received_commands) >= _MAX_COMMANDS:
            dropped = self._received_commands.popleft()
            if dropped.on_applied is not None:
                dropped.on_applied(None, "too many commands arrived before the next step; send fewer, or let time pass")
        self._received_commands.append(command)

    def latch_commands(self) -> None:
        """Makes all commands received so far due at the next step; later commands are due at later steps."""
        self._due_commands.extend(self._received_commands)
        self._received_commands.clear()

    def apply_commands(self, world: PhysicsWorld, journal: Journal) -> tuple[int, int]:
        """Applies the due commands in the order of their arrival, and records them in the journal.

        Returns:
            Number of commands, and number of refused commands.
        """
        count = refused = 0
        while self._due_commands:
            count += 1
            topic, message, on_applied = self._due_commands.popleft()
            journal.record(topic, message)
            problem = ""
            try:
                route = self._routes[topic]
                if on_applied is None:
                    self._preempt_goals(route.joints)
                route.apply(world, message)
            except (CommandError, PhysicsError) as error:
                refused += 1
                problem = str(error)
                self._node.get_logger().warning(problem, throttle_duration_sec=1.0)
            if on_applied is not None:
                on_applied(world, problem)
        return count, refused

    def _preempt_goals(self, joints: tuple[str, ...]) -> None:
        """Aborts the action goals that move any of these joints."""
        for action in (*self._trajectories, *self._grippers):
            if set(joints) & set(action.joints):
                action.preempt()

    def _apply_trajectory(self, joints: tuple[str, ...], world: PhysicsWorld, msg: JointTrajectory) -> None:
        _check_joints(msg.joint_names, joints)
        if not msg.points and not msg.joint_names:
            msg = JointTrajectory(joint_names=joints)
        world.command_joints(self._robot.name, conversions.joint_command_from_msg(msg))

    def _apply_joints(self, joints: tuple[str, ...], world: PhysicsWorld, msg: JointState) -> None:
        _check_joints(msg.name, joints)
        command = JointState(name=msg.name or joints, position=msg.position, velocity=msg.velocity, effort=msg.effort)
        world.command_joints(self._robot.name, conversions.joint_command_from_msg(command))

    def _apply_servo(self, arm: str, world: PhysicsWorld, msg: TwistStamped) -> None:
        world.arms.servo(self._robot.name, conversions.tool_twist_from_msg(msg, self._robot.frame_prefix), arm)

    def _apply_grasp(self, arm: str, world: PhysicsWorld, msg: Bool) -> None:
        (world.arms.grasp if msg.data else world.arms.release)(self._robot.name, arm)

    def _on_grasp(self, arm: str, topic: str, request: Any, response: Any) -> DeferredResponse:
        """Queues the grasp as a command; the service responds once it was applied."""
        deferred = DeferredResponse()

        def on_applied(world: PhysicsWorld | None, error: str) -> None:
            response.success, response.message = False, error
            if world is not None and not error:
                state = world.arms.grasp_state(self._robot.name, arm)
                response.success = state.holding == request.data
                response.message = f"holds {state.body}/{state.link}" if state.holding else state.reason
            deferred.send(response)

        self._send(topic, Bool(data=request.data), on_applied)
        return deferred

    # States

    def publish(self, world: PhysicsWorld, digests: DigestPublisher | None = None) -> None:
        """Publishes grasp states and collision counts, and updates the action goals; called at every tick."""
        self._now_ns, name = world.stamp_ns, self._robot.name
        for arm, publisher in self._grasp_pubs.items():
            if digests is not None or publisher.get_subscription_count():
                state = world.arms.grasp_state(name, arm)
                publisher.publish(conversions.grasp_state_to_msg(state, self._now_ns))
                if digests is not None:
                    digests.add(publisher.topic_name, state)
        if self._collisions_pub.get_subscription_count():
            self._collisions_pub.publish(conversions.collision_count_to_msg(world.collisions(name), self._now_ns))
        for action in (*self._trajectories, *self._grippers):
            action.update(name, world)

    def reset(self) -> None:
        """Drops commands and aborts goals: the simulation was reset."""
        dropped = (*self._due_commands, *self._received_commands)
        self._received_commands.clear()
        self._due_commands.clear()
        self._now_ns = 0
        for action in (*self._trajectories, *self._grippers):
            action.preempt(_RESET)
        for command in dropped:
            if command.on_applied is not None:
                command.on_applied(None, _RESET)

    def close(self) -> None:
        """Destroys topics, services and actions."""
        for action in (*self._trajectories, *self._grippers):
            action.close()
        for service in self._services:
            service.destroy()
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        for publisher in (*self._grasp_pubs.values(), self._collisions_pub):
            self._node.destroy_publisher(publisher)
        self._subscriptions, self._services, self._trajectories, self._grippers = [], [], [], []
        self._grasp_pubs = {}


def _check_joints(requested: Sequence[str], known: tuple[str, ...]) -> None:
    for name in requested:
        if name not in known:
            raise CommandError(
                f"joint {quoted(name)} does not belong to this controller, which has: {', '.join(known)}; use another controller"
            )
