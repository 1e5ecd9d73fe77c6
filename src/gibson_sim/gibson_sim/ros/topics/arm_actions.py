"""Actions of control_msgs for an arm and a gripper. They need the package control_msgs; the topics exist without it.

A goal becomes a message on a topic, so that a recorded run contains it like any other command. No function blocks: every tick updates the
goals.
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
"""Period of feedback, ns of simulation time."""
_PREEMPTED = "another command for these joints arrived"

OnApplied = Callable[[PhysicsWorld | None, str], None]
"""Called with the world and an empty text once a command was applied, or with the reason why it was not."""
SendCommand = Callable[[str, Any, OnApplied], None]
"""Sends a message on a topic, to be applied at the next step."""
ServerFactory = Callable[..., Any]


def control_actions() -> Any | None:
    """Returns the module ``control_msgs.action``, or None if it is not installed."""
    try:
        return import_module("control_msgs.action")
    except ImportError:
        return None


def control_msgs_missing(actions: Sequence[str]) -> str:
    """Returns the warning for actions that are not offered because control_msgs is not installed."""
    return (
        f"no package control_msgs here: {', '.join(actions)} {'is' if len(actions) == 1 else 'are'} not offered, the topics are; "
        "install ros-jazzy-control-msgs, or build and source ros_ws, which has control_msgs"
    )


class _SingleGoalServer:
    """An action server that executes one goal at a time; a new goal preempts the old one."""

    def __init__(self, node: Node, kind: Any, name: str, joints: tuple[str, ...], make_server: ServerFactory) -> None:
        self.joints = joints
        self._kind, self._log = kind, node.get_logger()
        self._goal: Any = None
        self._feedback_ns = 0
        self._server = make_server(
            node,
            kind,
            name,
            execute_callback=_unused,
            goal_callback=self._on_request,
            handle_accepted_callback=self._on_goal,
            cancel_callback=self._on_cancel,
        )

    def close(self) -> None:
        """Destroys the action server."""
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
        self.preempt()
        self._goal = goal
        self._feedback_ns = 0
        self._start(goal)

    def _on_cancel(self, goal: Any) -> CancelResponse:
        if goal is not self._goal:
            return CancelResponse.REJECT
        self._stop_joints()
        self._end_goal(self._canceled_result(), "canceled")
        return CancelResponse.ACCEPT

    def preempt(self, reason: str = _PREEMPTED) -> None:
        """Aborts the goal, if there is one."""
        if self._goal is not None:
            self._end_goal(self._failed_result(reason), "abort")

    def _end_goal(self, result: Any, transition: str) -> None:
        """Ends the goal by a method of its handle, ``canceled``, ``abort`` or ``succeed``; for rclpy, it executes only now."""
        goal, self._goal = self._goal, None

        def finish(handle: Any) -> Any:
            getattr(handle, "canceled" if handle.is_cancel_requested else transition)()
            return result

        goal.execute(finish)

    def _publish_feedback(self, now_ns: int, make_feedback: Callable[[], Any]) -> None:
        if now_ns - self._feedback_ns >= FEEDBACK_NS:
            self._feedback_ns = now_ns
            self._goal.publish_feedback(make_feedback())

    def update(self, robot: str, world: PhysicsWorld) -> None:
        """Ends the goal if it has succeeded or failed, otherwise publishes feedback; called at every tick."""
        raise NotImplementedError

    def _check(self, request: Any) -> None:
        raise NotImplementedError

    def _start(self, goal: Any) -> None:
        raise NotImplementedError

    def _stop_joints(self) -> None:
        raise NotImplementedError

    def _canceled_result(self) -> Any:
        raise NotImplementedError

    def _failed_result(self, reason: str) -> Any:
        raise NotImplementedError


class TrajectoryAction(_SingleGoalServer):
    """``control_msgs/FollowJointTrajectory`` of one arm."""

    def __init__(
        self,
        node: Node,
        kind: Any,
        name: str,
        topic: str,
        joints: tuple[str, ...],
        send: SendCommand,
        now_ns: Callable[[], int],
        *,
        make_server: ServerFactory = ActionServer,
    ) -> None:
        """Creates the action server.

        Args:
            node: node of the action server.
            kind: type of the action.
            name: name of the action.
            topic: topic of the trajectories of these joints.
            joints: joints that a goal may move.
            send: sends a message, to be applied at the next step.
            now_ns: returns simulation time, ns.
            make_server: creates the action server.
        """
        super().__init__(node, kind, name, joints, make_server)
        self._topic, self._send, self._now_ns = topic, send, now_ns
        self._tracker: TrajectoryGoal | None = None

    def _check(self, request: Any) -> None:
        tracker = self._read(request, self._now_ns())
        tracker.check(self.joints)
        if conversions.time_from_msg(request.trajectory.header.stamp) and tracker.end_ns < self._now_ns():
            raise CommandError(
                f"joint trajectory ended at {tracker.end_ns / NS_PER_S:g} s, now it is {self._now_ns() / NS_PER_S:g} s; "
                "set its stamp to 0 to start it immediately"
            )

    @staticmethod
    def _read(request: Any, now_ns: int) -> TrajectoryGoal:
        """Returns the end conditions of a goal that starts at ``now_ns``, or at its stamp if that is not 0."""
        conversions.joint_command_from_msg(request.trajectory)  # raises if it cannot be applied
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

    def _start(self, goal: Any) -> None:
        self._tracker = None

        def on_applied(world: PhysicsWorld | None, error: str) -> None:
            if goal is not self._goal:
                return
            if error or world is None:
                self._end_goal(self._result(Ended(TrajectoryCode.INVALID_GOAL, error)), "abort")
            else:
                self._tracker = self._read(goal.request, world.stamp_ns)

        self._send(self._topic, goal.request.trajectory, on_applied)

    def _stop_joints(self) -> None:
        names = self._goal.request.trajectory.joint_names
        self._send(self._topic, JointTrajectory(joint_names=names), _ignore_outcome)

    def update(self, robot: str, world: PhysicsWorld) -> None:
        """Ends the goal if it has succeeded or failed, otherwise publishes feedback; called at every tick."""
        tracker = self._tracker
        if self._goal is None or tracker is None:
            return
        states = world.joint_states(robot)
        positions = dict(zip(states.names, states.positions.tolist(), strict=True))
        velocities = dict(zip(states.names, states.velocities.tolist(), strict=True))
        desired = dict(zip(tracker.names, tracker.end, strict=True)) | world.joint_setpoints(robot)
        ended = tracker.outcome(world.stamp_ns, desired, positions, velocities)
        if ended is None:
            self._publish_feedback(
                world.stamp_ns, lambda: self._feedback(tracker, world.stamp_ns, desired, positions, velocities)
            )
            return
        if ended.code is TrajectoryCode.PATH_TOLERANCE_VIOLATED:
            self._stop_joints()
        self._end_goal(self._result(ended), "abort" if ended.code else "succeed")

    def _feedback(
        self,
        tracker: TrajectoryGoal,
        now_ns: int,
        desired: dict[str, float],
        positions: dict[str, float],
        velocities: dict[str, float],
    ) -> Any:
        msg = self._kind.Feedback(header=conversions.header_to_msg(now_ns, ""), joint_names=list(tracker.names))
        msg.desired = JointTrajectoryPoint(positions=[desired[name] for name in tracker.names])
        msg.actual = JointTrajectoryPoint(
            positions=[positions[name] for name in tracker.names], velocities=[velocities[name] for name in tracker.names]
        )
        msg.error = JointTrajectoryPoint(positions=[desired[name] - positions[name] for name in tracker.names])
        return msg

    def _result(self, ended: Ended) -> Any:
        return self._kind.Result(error_code=int(ended.code), error_string=ended.reason)

    def _canceled_result(self) -> Any:
        return self._result(Ended(TrajectoryCode.SUCCESSFUL, "canceled; the joints stop where they are"))

    def _failed_result(self, reason: str) -> Any:
        return self._result(Ended(TrajectoryCode.INVALID_GOAL, reason))


class GripperAction(_SingleGoalServer):
    """``control_msgs/GripperCommand`` of one gripper: ``position`` is the position of every finger joint."""

    def __init__(
        self,
        node: Node,
        kind: Any,
        name: str,
        topic: str,
        joints: tuple[str, ...],
        send: SendCommand,
        *,
        make_server: ServerFactory = ActionServer,
    ) -> None:
        """Creates the action server; the arguments are those of ``TrajectoryAction``, with joint commands on ``topic``."""
        super().__init__(node, kind, name, joints, make_server)
        self._topic, self._send = topic, send
        self._tracker: GripperGoal | None = None
        self._last: dict[str, Any] = {}

    def _check(self, request: Any) -> None:
        conversions.joint_command_from_msg(self._message(request))

    def _message(self, request: Any) -> JointState:
        """Returns the joint command of a goal; if ``max_effort`` is 0, the effort limits of the robot description apply."""
        command, count = request.command, len(self.joints)
        return JointState(name=list(self.joints), position=[command.position] * count, effort=[command.max_effort] * count)

    def _start(self, goal: Any) -> None:
        self._tracker, self._last = None, {}

        def on_applied(world: PhysicsWorld | None, error: str) -> None:
            if goal is not self._goal:
                return
            if error or world is None:
                self._log.warning(f"goal of the gripper refused: {error}")
                self.preempt(error)
            else:
                self._tracker = GripperGoal(self.joints, goal.request.command.position, world.stamp_ns)

        self._send(self._topic, self._message(goal.request), on_applied)

    def _stop_joints(self) -> None:
        if self._last:
            stop = JointState(name=list(self.joints), velocity=[0.0] * len(self.joints))
            self._send(self._topic, stop, _ignore_outcome)

    def update(self, robot: str, world: PhysicsWorld) -> None:
        """Ends the goal if it has succeeded or failed, otherwise publishes feedback; called at every tick."""
        if self._goal is None or self._tracker is None:
            return
        states = world.joint_states(robot)
        rows = (
            dict(zip(states.names, row.tolist(), strict=True)) for row in (states.positions, states.velocities, states.efforts)
        )
        state = self._tracker.outcome(world.stamp_ns, *rows)
        self._last = {
            "position": state.position, "effort": state.effort, "stalled": state.stalled, "reached_goal": state.reached_goal,
        }  # fmt: skip
        if state.is_over:
            self._end_goal(self._kind.Result(**self._last), "succeed")
        else:
            self._publish_feedback(world.stamp_ns, lambda: self._kind.Feedback(**self._last))

    def _canceled_result(self) -> Any:
        return self._kind.Result(**self._last)

    def _failed_result(self, reason: str) -> Any:
        return self._kind.Result(**self._last)


def _ignore_outcome(world: PhysicsWorld | None, error: str) -> None:
    """Does nothing: the ``OnApplied`` of commands whose outcome is not needed."""


def _unused(_: Any) -> Any:
    raise AssertionError("goals have their own callbacks")
