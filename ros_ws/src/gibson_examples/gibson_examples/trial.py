"""``python -m gibson_examples.trial``: starts a simulation and the navigation node, and judges the drives by ground truth.

Every run starts where the previous one ended, with an initial pose that has a seeded error. A run is successful if the true
position is within 0.25 m of the goal and the robot's disc has touched no obstacle of the map (``judging.py``).
"""

from __future__ import annotations

import argparse
import json
import math
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import OccupancyGrid, Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_msgs.msg import String

from gibson_examples import conversions
from gibson_examples.errors import NavigationError
from gibson_examples.geometry import Pose2D, format_pose, wrap_angle
from gibson_examples.grid import Grid
from gibson_examples.judging import Run, Trial, describe, initial_error, track_clearance
from gibson_examples.node import LATCHED
from gibson_examples.routes import Course, course_of
from gibson_examples.transforms import NS_PER_S

LIMIT_S = 240.0
"""Longest run, seconds of simulation time."""
TIMEOUT_S = 180.0
"""Longest wait without progress, seconds of wall time."""
SETTLE_NS = NS_PER_S // 2
"""Pause before and after a run, nanoseconds of simulation time."""


class _Process:
    """A started program, with its output in a file."""

    def __init__(self, name: str, command: list[str], folder: Path) -> None:
        self.name, self._log = name, folder / f"{name}.log"
        with self._log.open("wb") as log:
            self._process = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL)

    def check(self) -> None:
        """Raises NavigationError if the program has ended."""
        if self._process.poll() is not None:
            raise NavigationError(f"{self.name} ended with code {self._process.returncode}; its last output:\n{self.tail()}")

    def tail(self) -> str:
        """Returns the last lines of the output."""
        return "\n".join(self._log.read_text(errors="replace").splitlines()[-15:])

    def cpu_s(self) -> float:
        """Returns the processor time used so far, seconds."""
        fields = Path(f"/proc/{self._process.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def stop(self) -> None:
        """Ends the program as Ctrl-C does; kills it after 30 s."""
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)
        try:
            self._process.wait(timeout=30)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


class _Judge:
    """Sends initial poses and goals, and records the ground truth."""

    def __init__(self, processes: list[_Process]) -> None:
        self._processes = processes
        self._context = rclpy.Context()
        self._context.init()
        self._node: Any = Node("trial", context=self._context, use_global_arguments=False)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self.grid: Grid | None = None
        self.status = ""
        self.recoveries: list[str] = []
        self.now_ns = -1
        self.truth = Pose2D(0.0, 0.0, 0.0)
        self.track: list[tuple[float, float]] = []
        self._true_at: dict[int, Pose2D] = {}
        self.errors: list[float] = []
        self._initial_pub = self._node.create_publisher(PoseWithCovarianceStamped, "initialpose", 10)
        self._goal_pub = self._node.create_publisher(PoseStamped, "goal_pose", 10)
        self._node.create_subscription(OccupancyGrid, "map", self._on_map, LATCHED)
        self._node.create_subscription(Odometry, "ground_truth/odom", self._on_truth, 50)
        self._node.create_subscription(String, "navigation/status", self._on_status, 50)
        self._node.create_subscription(PoseWithCovarianceStamped, "pose", self._on_pose, 50)

    def _on_map(self, msg: Any) -> None:
        self.grid = conversions.grid_from(msg)

    def _on_status(self, msg: Any) -> None:
        self.status = str(msg.data)
        if self.status.startswith("recovering"):
            self.recoveries.append(self.status)

    def _on_truth(self, msg: Any) -> None:
        self.now_ns, self.truth = conversions.stamp_ns(msg.header.stamp), conversions.pose_from(msg.pose.pose)
        self.track.append((self.truth.x, self.truth.y))
        self._true_at[self.now_ns] = self.truth
        if len(self._true_at) > 240:
            del self._true_at[next(iter(self._true_at))]

    def _on_pose(self, msg: Any) -> None:
        true = self._true_at.get(conversions.stamp_ns(msg.header.stamp))
        if true is not None:
            self.errors.append(conversions.pose_from(msg.pose.pose).distance(true))

    def wait_until(self, condition: Callable[[], bool], what: str) -> None:
        """Spins until the condition holds; raises NavigationError after ``TIMEOUT_S`` without progress."""
        deadline, seen_ns = time.monotonic() + TIMEOUT_S, self.now_ns
        while not condition():
            self._executor.spin_once(timeout_sec=0.05)
            for process in self._processes:
                process.check()
            if self.now_ns != seen_ns and what == "end of a run":
                deadline, seen_ns = time.monotonic() + TIMEOUT_S, self.now_ns
            if time.monotonic() > deadline:
                last = "\n".join(f"{p.name}:\n{p.tail()}" for p in self._processes)
                raise NavigationError(f"still no {what} after {TIMEOUT_S:.0f} s; status {self.status!r}\n{last}")

    def settle(self) -> None:
        """Waits for half a second of simulation time."""
        until = self.now_ns + SETTLE_NS
        self.wait_until(lambda: self.now_ns >= until, "simulation time")

    def ready(self) -> bool:
        """Returns whether map and ground truth have arrived and the navigation node has subscribed."""
        matched = self._initial_pub.get_subscription_count() and self._goal_pub.get_subscription_count()
        return self.grid is not None and self.now_ns >= 0 and bool(matched)

    def send_initial_pose(self, pose: Pose2D) -> None:
        """Publishes an initial pose with standard deviations of 0.15 m and 8 degrees."""
        covariance = np.diag([0.15**2, 0.15**2, math.radians(8.0) ** 2])
        self._initial_pub.publish(conversions.pose_with_covariance_msg(pose, covariance, self.now_ns, "map"))

    def send_goal(self, pose: Pose2D) -> None:
        """Publishes a goal."""
        self._goal_pub.publish(conversions.goal_msg(pose, self.now_ns, "map"))

    def close(self) -> None:
        """Destroys the node and its context."""
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()


def _drive(judge: _Judge, course: Course, goal: Pose2D, error: Pose2D) -> Run:
    """Drives to one goal and returns the result."""
    assert judge.grid is not None
    judge.send_initial_pose(judge.truth @ error)
    judge.settle()
    judge.track.clear()
    judge.errors.clear()
    judge.recoveries.clear()
    start_ns, goal_text = judge.now_ns, format_pose(goal)
    judge.send_goal(goal)

    def over() -> bool:
        ended = judge.status.startswith((f"reached {goal_text}", f"failed {goal_text}"))
        return ended or judge.now_ns - start_ns > LIMIT_S * NS_PER_S

    judge.wait_until(over, "end of a run")
    duration = (judge.now_ns - start_ns) / NS_PER_S
    judge.settle()
    track = np.array(judge.track)
    clearance, closest = track_clearance(judge.grid, track)
    return Run(
        goal=goal_text,
        status=judge.status,
        error=judge.truth.distance(goal),
        heading_error_deg=abs(math.degrees(wrap_angle(judge.truth.yaw - goal.yaw))),
        clearance=clearance,
        closest=closest,
        length=float(np.hypot(*np.diff(track, axis=0).T).sum()),
        duration=duration,
        doorways=tuple(doorway.name for doorway in course.doorways if doorway.crossed_by(track)),
        recoveries=len(judge.recoveries),
        localisation_error=float(np.mean(judge.errors)) if judge.errors else math.nan,
        localisation_error_max=float(np.max(judge.errors)) if judge.errors else math.nan,
    )


def run_trial(
    scene: str,
    robot: str,
    *,
    runs: int = 10,
    rate: float = 3.0,
    seed: int = 0,
    stamped: bool = False,
    report: Callable[[Run], None] = lambda run: None,
) -> Trial:
    """Starts a simulation without images and the navigation node, and drives to the first ``runs`` goals of the scene's course.

    Args:
        scene: value of ``gibson-sim run --scene``; the scene must have a course.
        robot: value of ``--robot``.
        runs: 1 to 10.
        rate: speed of simulation time against wall time.
        seed: seed of the errors of the initial poses and of the particles.
        stamped: send TwistStamped.
        report: called after each run.

    Raises:
        NavigationError: the scene has no course, or a program ended or hangs.
    """
    course = course_of(scene)
    beside = Path(sys.executable).with_name("gibson-sim")
    program = str(beside) if beside.exists() else "gibson-sim"
    simulation = [
        program,
        "run",
        "--scene",
        scene,
        "--robot",
        robot,
        "--no-render",
        f"--start={course.start}",
        "--rate",
        str(rate),
    ]
    navigation = [sys.executable, "-m", "gibson_examples.navigate", "--ros-args", "-p", f"seed:={seed}"]
    navigation += ["-p", f"stamped:={str(stamped).lower()}"]
    processes: list[_Process] = []
    judge: _Judge | None = None
    with tempfile.TemporaryDirectory() as folder:
        try:
            processes.append(_Process("simulation", simulation, Path(folder)))
            processes.append(_Process("navigation", navigation, Path(folder)))
            judge = _Judge(processes)
            judge.wait_until(judge.ready, "map, truth and navigation")
            assert judge.grid is not None
            course.check(judge.grid)
            start_ns, start_s, cpu_s = judge.now_ns, time.monotonic(), processes[1].cpu_s()
            results = []
            for i, goal in enumerate(course.poses()[:runs]):
                results.append(_drive(judge, course, goal, initial_error(seed, i)))
                report(results[-1])
            simulated_s = (judge.now_ns - start_ns) / NS_PER_S
            factor, cpu = simulated_s / (time.monotonic() - start_s), (processes[1].cpu_s() - cpu_s) / simulated_s
            return Trial(scene, robot, rate, seed, tuple(results), factor, cpu)
        finally:
            if judge is not None:
                judge.close()
            for process in reversed(processes):
                process.stop()


def main(args: list[str] | None = None) -> None:
    """Runs a trial and prints it; exits with 0 if every run is successful."""
    parser = argparse.ArgumentParser(description="Drives to goals through doorways and judges the drives by ground truth.")
    parser.add_argument("--scene", default="flat", help="name or file of a scene that has a course (default: flat)")
    parser.add_argument("--robot", default="gibson_bot_real", help="name or folder of the robot (default: gibson_bot_real)")
    parser.add_argument("--runs", type=int, default=10, choices=range(1, 11), metavar="N", help="1 to 10 (default: 10)")
    parser.add_argument("--rate", type=float, default=3.0, help="speed of simulation time against wall time (default: 3)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the initial errors and the particles (default: 0)")
    parser.add_argument("--stamped", action="store_true", help="send TwistStamped")
    parser.add_argument("--json", type=Path, help="also write the results to this file")
    options = parser.parse_args(args)
    try:
        trial = run_trial(
            options.scene,
            options.robot,
            runs=options.runs,
            rate=options.rate,
            seed=options.seed,
            stamped=options.stamped,
            report=lambda run: print(describe(run), flush=True),
        )
    except NavigationError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(1)
    print(
        f"{trial.passed} of {len(trial.runs)}; {trial.real_time_factor:.1f} simulated seconds per second, "
        f"{trial.cpu_per_simulated_second:.2f} s of processor time of the node for each"
    )
    if options.json:
        options.json.write_text(json.dumps(asdict(trial), indent=2) + "\n")
    sys.exit(0 if trial.passed == len(trial.runs) else 1)


if __name__ == "__main__":
    main()
