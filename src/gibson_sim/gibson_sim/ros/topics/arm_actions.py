"""The actions of control_msgs around an arm and a gripper. Where control_msgs is not installed there are none; the topics are there anyway.

A goal becomes a message on a topic, so that a recorded run holds it like any other command. Nothing here waits: what a goal has come to
is looked at in every tick.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Any

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.node import Node
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from gibson_sim.errors import CommandError
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.robots.joints.goals import Ended, GripperGoal, Tolerance, TrajectoryCode, TrajectoryGoal
from gibson_sim.ros import conversions
from gibson_sim.types import NS_PER_S

FEEDBACK_NS = NS_PER_S // 20
"""Between two messages of feedback, simulation time."""
_REPLACED = "another command for these joints came"

Answer = Callable[[PhysicsWorld | None, str], None]
"""Is told when a command was obeyed, by which world, or why it was not."""
Send = Callable[[str, Any, Answer], None]
"""Takes a topic, a message, and whom to tell: the next step obeys it."""
MakeServer = Callable[..., Any]


def control_actions() -> Any | None:
    """Returns the module ``control_msgs.action``, or None where it is not installed."""
    try:
        return import_module("control_msgs.action")
    except ImportError:
        return None


def without_control_msgs(actions: Sequence[str]) -> str:
    """Returns what to say where the actions of these names cannot be offered."""
    return (
        f"no package control_msgs here: {', '.join(actions)} {'is' if len(actions) == 1 else 'are'} not offered, the topics are; "
        "install ros-jazzy-control-msgs, or build and source ros_ws, which has control_msgs"
    )


class _OneGoal:
    """An action server that pursues one goal at a time; a new one takes the place of the old one."""

    def __init__(self, node: Node, kind: Any, name: str, joints: tuple[str, ...], make_server: MakeServer) -> None:
        self.joints = joints
        self._kind, self._log = kind, node.get_logger()
        self._goal: Any = None
        self._fed_ns = 0
        self._server = make_server(
            node,
            kind,
            name,
            execute_callback=_never,
            goal_callback=self._on_request,
            handle_accepted_callback=self._on_goal,
            cancel_callback=self._on_cancel,
        )

    def close(self) -> None:
        """Takes the action back."""
        self._goal = None
        self._server.destroy()

    def _on_request(self, request: Any) -> GoalResponse:
        try:
            self._check(request)
        except CommandError as error:
            self._log.warning(f"goal refused: {error}")
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    def _on_goal(self, goal: Any) -> None:
        self.give_way()
        self._goal = goal
        self._fed_ns = 0
        self._begin(goal)

    def _on_cancel(self, goal: Any) -> CancelResponse:
        if goal is not self._goal:
            return CancelResponse.REJECT
        self._hold()
        self._end_with(self._canceled_result(), "canceled")
        return CancelResponse.ACCEPT

    def give_way(self, reason: str = _REPLACED) -> None:
        """Ends the goal, if there is one: something else decides now."""
        if self._goal is not None:
            self._end_with(self._failed_result(reason), "abort")

    def _end_with(self, result: Any, how: str) -> None:
        """Ends the goal; in rclpy's sense it is executed only now."""
        goal, self._goal = self._goal, None

        def finish(handle: Any) -> Any:
            getattr(handle, "canceled" if handle.is_cancel_requested else how)()
            return result

        goal.execute(finish)

    def _feed(self, now_ns: int, make: Callable[[], Any]) -> None:
        if now_ns - self._fed_ns >= FEEDBACK_NS:
            self._fed_ns = now_ns
            self._goal.publish_feedback(make())

    def update(self, robot: str, world: PhysicsWorld) -> None:
        """Looks what became of the goal; for every tick."""
        raise NotImplementedError

    def _check(self, request: Any) -> None:
        raise NotImplementedError

    def _begin(self, goal: Any) -> None:
        raise NotImplementedError

    def _hold(self) -> None:
        raise NotImplementedError

    def _canceled_result(self) -> Any:
        raise NotImplementedError

    def _failed_result(self, reason: str) -> Any:
        raise NotImplementedError


class TrajectoryAction(_OneGoal):
    """``control_msgs/FollowJointTrajectory`` of one arm."""

    def __init__(
        self,
        node: Node,
        kind: Any,
        name: str,
        topic: str,
        joints: tuple[str, ...],
        send: Send,
        now_ns: Callable[[], int],
        *,
        make_server: MakeServer = ActionServer,
    ) -> None:
        """Offers the action.

        Args:
            node: On whose behalf.
            kind: The action's type.
            name: The action's name.
            topic: On which trajectories of these joints come.
            joints: That a goal may move.
            send: Lets the next step obey a message.
            now_ns: Returns simulation time.
            make_server: Makes the server.
        """
        super().__init__(node, kind, name, joints, make_server)
        self._topic, self._send, self._now_ns = topic, send, now_ns
        self._rules: TrajectoryGoal | None = None

    def _check(self, request: Any) -> None:
        rules = self._read(request, self._now_ns())
        rules.check(self.joints)
        if conversions.time_from_msg(request.trajectory.header.stamp) and rules.end_ns < self._now_ns():
            raise CommandError(
                f"joint trajectory ended at {rules.end_ns / NS_PER_S:g} s, now it is {self._now_ns() / NS_PER_S:g} s; "
                "stamp it 0 to start at once"
            )

    @staticmethod
    def _read(request: Any, now_ns: int) -> TrajectoryGoal:
        """Returns the rules of a goal that begins at ``now_ns``, unless its stamp says otherwise."""
        conversions.joint_command_from_msg(request.trajectory)  # refuses what cannot be obeyed
        if not request.trajectory.points:
            raise CommandError("joint trajectory has no points; give at least one, or cancel the goal to stop")
        last = request.trajectory.points[-1]
        duration_ns = conversions.time_from_msg(last.time_from_start)
        start_ns = conversions.time_from_msg(request.trajectory.header.stamp) or now_ns
        path, goal = (
            {item.name: Tolerance(item.position, item.velocity) for item in row}
            for row in (request.path_tolerance, request.goal_tolerance)
        )
        goal_time = conversions.time_from_msg(request.goal_time_tolerance) / NS_PER_S
        return TrajectoryGoal(
            tuple(request.trajectory.joint_names), tuple(last.positions), start_ns + duration_ns, path, goal, goal_time
        )

    def _begin(self, goal: Any) -> None:
        self._rules = None

        def answer(world: PhysicsWorld | None, error: str) -> None:
            if goal is not self._goal:
                return
            if error or world is None:
                self._end_with(self._result(Ended(TrajectoryCode.INVALID_GOAL, error)), "abort")
            else:
                self._rules = self._read(goal.request, world.stamp_ns)

        self._send(self._topic, goal.request.trajectory, answer)

    def _hold(self) -> None:
        names = self._goal.request.trajectory.joint_names
        self._send(self._topic, JointTrajectory(joint_names=names), _look_away)

    def update(self, robot: str, world: PhysicsWorld) -> None:
        """Looks what became of the goal; for every tick."""
        rules = self._rules
        if self._goal is None or rules is None:
            return
        states = world.joint_states(robot)
        positions = dict(zip(states.names, states.positions.tolist(), strict=True))
        velocities = dict(zip(states.names, states.velocities.tolist(), strict=True))
        desired = dict(zip(rules.names, rules.end, strict=True)) | world.joint_setpoints(robot)
        ended = rules.outcome(world.stamp_ns, desired, positions, velocities)
        if ended is None:
            self._feed(world.stamp_ns, lambda: self._feedback(rules, world.stamp_ns, desired, positions, velocities))
            return
        if ended.code is TrajectoryCode.PATH_TOLERANCE_VIOLATED:
            self._hold()
        self._end_with(self._result(ended), "abort" if ended.code else "succeed")

    def _feedback(
        self,
        rules: TrajectoryGoal,
        now_ns: int,
        desired: dict[str, float],
        positions: dict[str, float],
        velocities: dict[str, float],
    ) -> Any:
        msg = self._kind.Feedback(header=conversions.header_to_msg(now_ns, ""), joint_names=list(rules.names))
        msg.desired = JointTrajectoryPoint(positions=[desired[name] for name in rules.names])
        msg.actual = JointTrajectoryPoint(
            positions=[positions[name] for name in rules.names], velocities=[velocities[name] for name in rules.names]
        )
        msg.error = JointTrajectoryPoint(positions=[desired[name] - positions[name] for name in rules.names])
        return msg

    def _result(self, ended: Ended) -> Any:
        return self._kind.Result(error_code=int(ended.code), error_string=ended.reason)

    def _canceled_result(self) -> Any:
        return self._result(Ended(TrajectoryCode.SUCCESSFUL, "canceled; the joints stop where they are"))

    def _failed_result(self, reason: str) -> Any:
        return self._result(Ended(TrajectoryCode.INVALID_GOAL, reason))


class GripperAction(_OneGoal):
    """``control_msgs/GripperCommand`` of one gripper: ``position`` is that of every finger."""

    def __init__(
        self,
        node: Node,
        kind: Any,
        name: str,
        topic: str,
        joints: tuple[str, ...],
        send: Send,
        *,
        make_server: MakeServer = ActionServer,
    ) -> None:
        """Offers the action; the arguments are those of ``TrajectoryAction``, and joint commands come on ``topic``."""
        super().__init__(node, kind, name, joints, make_server)
        self._topic, self._send = topic, send
        self._rules: GripperGoal | None = None
        self._last: dict[str, Any] = {}

    def _check(self, request: Any) -> None:
        conversions.joint_command_from_msg(self._message(request))

    def _message(self, request: Any) -> JointState:
        """Returns what a goal asks of the fingers; without an effort they press as hard as the robot's file says."""
        command, count = request.command, len(self.joints)
        return JointState(name=list(self.joints), position=[command.position] * count, effort=[command.max_effort] * count)

    def _begin(self, goal: Any) -> None:
        self._rules, self._last = None, {}

        def answer(world: PhysicsWorld | None, error: str) -> None:
            if goal is not self._goal:
                return
            if error or world is None:
                self._log.warning(f"goal of the gripper refused: {error}")
                self.give_way(error)
            else:
                self._rules = GripperGoal(self.joints, goal.request.command.position, world.stamp_ns)

        self._send(self._topic, self._message(goal.request), answer)

    def _hold(self) -> None:
        if self._last:
            stay = JointState(name=list(self.joints), velocity=[0.0] * len(self.joints))
            self._send(self._topic, stay, _look_away)

    def update(self, robot: str, world: PhysicsWorld) -> None:
        """Looks what became of the goal; for every tick."""
        if self._goal is None or self._rules is None:
            return
        states = world.joint_states(robot)
        rows = (
            dict(zip(states.names, row.tolist(), strict=True)) for row in (states.positions, states.velocities, states.efforts)
        )
        now = self._rules.outcome(world.stamp_ns, *rows)
        self._last = {"position": now.position, "effort": now.effort, "stalled": now.stalled, "reached_goal": now.reached_goal}
        if now.is_over:
            self._end_with(self._kind.Result(**self._last), "succeed")
        else:
            self._feed(world.stamp_ns, lambda: self._kind.Feedback(**self._last))

    def _canceled_result(self) -> Any:
        return self._kind.Result(**self._last)

    def _failed_result(self, reason: str) -> Any:
        return self._kind.Result(**self._last)


def _look_away(world: PhysicsWorld | None, error: str) -> None:
    """Stands where nobody wants to know what became of a command."""


def _never(_: Any) -> Any:
    raise AssertionError("goals bring their own callback")
