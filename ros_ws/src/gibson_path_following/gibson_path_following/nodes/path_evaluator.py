"""``path_evaluator``: evaluates a drive along a path by ground truth. No other node subscribes to it."""

from __future__ import annotations

import importlib
import json
import os
import re
from dataclasses import asdict
from pathlib import Path
from typing import Any

from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import String
from std_srvs.srv import Trigger

from gibson_path_following.errors import PathFollowingError, SettingError, quoted
from gibson_path_following.nodes import conversions
from gibson_path_following.nodes.parameters import declared
from gibson_path_following.nodes.running import run_node
from gibson_path_following.options import EvaluatorOptions
from gibson_path_following.paths.evaluation import EvaluationSettings, TracePoint, evaluate, node_positions, verdict
from gibson_path_following.paths.path_folder import load_path

_QOS = QoSProfile(depth=50, reliability=ReliabilityPolicy.BEST_EFFORT)
_BACK_NS = 1_000_000_000
"""Step backwards of the stamps from which on time has jumped, ns: a reset of the simulation."""
_MESSAGE_TYPE = re.compile(r"[a-z]\w*/msg/[A-Z]\w*", re.ASCII)
_REST_NS = 1_000_000_000
"""Time after the end of the path for which the trace goes on, ns."""


class PathEvaluatorNode(Node):
    """Evaluates a drive along a path by ground truth, in simulation.

    The drive begins with the first ``path/state`` that is ``following``, and ends a second after it is ``finished``, at the time limit, at
    a call, or with the node. The results are then written as JSON. If stamps go back, as at a reset, it starts over.

    Parameters: the fields of ``gibson_path_following.options.EvaluatorOptions``.

    Subscribes:
        ground_truth/odom (nav_msgs/Odometry): true pose of the robot, in the frame of the path's poses.
        ``collision_topic``, of ``collision_type``.
        path/state (std_msgs/String, latched): of ``path_policy``.

    Services (std_srvs/Trigger):
        path_evaluator/finish: ends the drive and writes the results.
    """

    def __init__(self, **kwargs: Any) -> None:
        """Reads the parameters and the path. ``kwargs`` go to ``rclpy.node.Node``.

        Raises:
            PathFollowingError: a parameter or the path cannot be used.
        """
        super().__init__("path_evaluator", **kwargs)
        self._options = o = declared(self, EvaluatorOptions)
        self.exit_code: int | None = None
        self._nodes = node_positions(load_path(o.path))
        self._settings = EvaluationSettings(arrival_radius=o.arrival_radius)
        self._trace: list[TracePoint] = []
        self._states: list[tuple[float, str]] = []
        """Time since the begin, seconds, and the state of the policy from then on."""
        self._touched = self._touching = False
        self._count: int | None = None
        self._ended_ns: int | None = None
        self._is_driving = self._is_written = False
        self._truth_ns: int | None = None
        """Stamp of the newest pose, ns."""
        latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        if o.collision_topic:
            self.create_subscription(_message_type(o.collision_type), o.collision_topic, self._on_collision, _QOS)
        self.create_subscription(String, "path/state", self._on_state, latched)
        self.create_subscription(Odometry, "ground_truth/odom", self._on_truth, _QOS)
        self.create_service(Trigger, "path_evaluator/finish", self._on_finish)

    def _on_collision(self, msg: Any) -> None:
        if hasattr(msg, "data"):
            self._touching = bool(msg.data)
        else:
            begun = self._count is not None and int(msg.count) > self._count
            self._count, self._touching = int(msg.count), int(msg.ongoing) > 0 or begun
        self._touched = self._touched or self._touching

    def _on_state(self, msg: Any) -> None:
        state = str(msg.data)
        if state == "following" and not self._is_driving:
            self._is_driving, self._touched = True, self._touching
        if not self._is_driving:
            return
        since = (self._trace[-1].stamp_ns - self._trace[0].stamp_ns) / conversions.NS_PER_S if self._trace else 0.0
        self._states.append((since, state))
        if state == "finished" and self._ended_ns is None and self._trace:
            self._ended_ns = self._trace[-1].stamp_ns

    def _on_truth(self, msg: Any) -> None:
        pose, stamp_ns = conversions.pose_from(msg), conversions.stamp_ns(msg.header.stamp)
        if self._truth_ns is not None and stamp_ns < self._truth_ns - _BACK_NS:
            self._start_over()
        self._truth_ns = stamp_ns
        if not self._is_driving or self._is_written or pose is None or (self._trace and stamp_ns <= self._trace[-1].stamp_ns):
            return
        self._trace.append(TracePoint(stamp_ns, *pose, in_collision=self._touched))
        self._touched = self._touching
        limit_ns = self._options.time_limit * conversions.NS_PER_S
        is_late = limit_ns > 0.0 and stamp_ns - self._trace[0].stamp_ns >= limit_ns
        if is_late or (self._ended_ns is not None and stamp_ns - self._ended_ns >= _REST_NS):
            try:
                self.get_logger().info(self._write())
            except PathFollowingError as error:
                self.get_logger().error(str(error))
            if self._options.exit_at_end:
                self.exit_code = 0 if self._is_written else 1

    def _start_over(self) -> None:
        dropped = "; the drive before is dropped" if self._trace and not self._is_written else ""
        self.get_logger().warning(f"stamps have gone back: evaluating anew{dropped}")
        # The policy may drive on without a change of its state.
        self._states = [(0.0, "following")] if self._states and self._states[-1][1] == "following" else []
        self._trace, self._ended_ns, self._is_written = [], None, False
        self._is_driving, self._touched = bool(self._states), self._touching

    def _on_finish(self, request: Any, response: Any) -> Any:
        try:
            response.success, response.message = True, self._write()
        except PathFollowingError as error:
            response.success, response.message = False, str(error)
        return response

    def _write(self) -> str:
        """Writes the results and returns them in a line.

        Raises:
            PathFollowingError: no drive has begun, or the file cannot be written.
        """
        if not self._trace:
            missing = (
                "no pose came from ground_truth/odom" if self._is_driving else "path/state was never following; start path_policy"
            )
            raise PathFollowingError(f"no drive was evaluated, {self._options.file} is not written: {missing}")
        outcome = evaluate(self._nodes, self._trace, self._settings)
        result = {
            "path": self._options.path, "nodes": len(self._nodes), **asdict(outcome), "arrival_radius": self._options.arrival_radius,
            "states": [[round(since, 3), state] for since, state in self._states],
        }  # fmt: skip
        file = Path(self._options.file)
        draft = file.with_name(f".{file.name}.{os.getpid()}.part")
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            draft.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
            draft.replace(file)
        except OSError as error:
            draft.unlink(missing_ok=True)
            raise SettingError(f"cannot write {file}: {error.strerror}") from error
        self._is_written = True
        return (
            f"{verdict(outcome, self._options.arrival_radius)}. Coverage {outcome.coverage:.2f}, mean deviation {outcome.deviation_mean:.2f} m, "
            f"SPL {outcome.spl:.2f}; wrote {file}"
        )

    def stop(self) -> None:
        """Writes the results of a drive that has not ended.

        Raises:
            PathFollowingError: there was no drive, or they cannot be written.
        """
        if not self._is_written:
            print(self._write(), flush=True)


def _message_type(name: str) -> Any:
    """Returns the class of a message type such as std_msgs/msg/Bool.

    Raises:
        SettingError: there is none, or it has no field for collisions.
    """
    if not _MESSAGE_TYPE.fullmatch(name):
        raise SettingError(f"parameter collision_type is {quoted(name)}, must be PACKAGE/msg/NAME, such as std_msgs/msg/Bool")
    package, _, kind = name.partition("/msg/")
    try:
        found = getattr(importlib.import_module(f"{package}.msg"), kind)
    except (ImportError, AttributeError) as error:
        raise SettingError(
            f"parameter collision_type is {quoted(name)}, a message type that is not installed; give one such as std_msgs/msg/Bool"
        ) from error
    types = found.get_fields_and_field_types()
    if types.get("data") != "boolean" and not {"count", "ongoing"} <= set(types):
        raise SettingError(
            f"parameter collision_type is {quoted(name)}, which has neither a bool `data` nor `count` and `ongoing`; give one such as "
            "std_msgs/msg/Bool"
        )
    return found


def main(args: list[str] | None = None) -> None:
    """Runs the node."""
    run_node(PathEvaluatorNode, EvaluatorOptions, args)


if __name__ == "__main__":
    main()
