"""Drives a path by images while the camera fails, or a person crosses; says what the robot did. Plain ROS 2 and our package.

After `source env.sh`: python tests/acceptance/path_following_faults.py [NAME ...] [--backend learned]. It starts the simulation and all nodes
by itself, in lockstep: time waits for images, so a slow machine changes nothing. Names: plain covered dropped delayed person standing
robots; all by default.
"""

import argparse
import itertools
import json
import math
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import rclpy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rclpy.executors import ExternalShutdownException
from rclpy.qos import qos_profile_sensor_data
from simulation_interfaces.srv import DeleteEntity, ResetSimulation, SetEntityState, SpawnEntity

from gibson_path_following.path_folder import load_path
from gibson_sim.trials.execution.walking import person_pose, person_urdf
from gibson_sim.trials.records import Person

ROBOT = Path(__file__).resolve().parents[2] / "docs" / "examples" / "path_robot"
FAULTS = {
    "plain": (),
    "covered": ("-p", "cover_after:=3.0", "-p", "cover:=3.0"),
    "dropped": ("-p", "drop:=0.5"),
    "delayed": ("-p", "delay:=0.2"),
    "person": (),
    "standing": (),
}
TIME_LIMIT = 90.0
"""Seconds of simulation time for a drive."""


STARTED: list[subprocess.Popen[bytes]] = []


def start(module: str, *arguments: str, log: Path) -> subprocess.Popen[bytes]:
    with log.open("w") as out:
        process = subprocess.Popen([sys.executable, "-m", module, *arguments], stdout=out, stderr=subprocess.STDOUT)
    STARTED.append(process)
    return process


def node(name: str, namespace: str, log: Path, **parameters: object) -> subprocess.Popen[bytes]:
    given = [text for key, value in parameters.items() for text in ("-p", f"{key}:={value}")]
    topics = ("-r", "odom:=ground_truth/odom", "-r", f"__ns:=/{namespace}")
    return start(f"gibson_path_following.nodes.{name}", "--ros-args", "-p", "use_sim_time:=true", *given, *topics, log=log)


def end(*processes: subprocess.Popen[bytes]) -> None:
    for process in processes:
        if process.poll() is None:
            process.terminate()
    for process in processes:
        process.wait(60)


class Simulation:
    """A running simulation, and what this program hears of its robots."""

    def __init__(self, log: Path, robots: str, scene: str, starts: str = "") -> None:
        more = ("--start", starts) if starts else ()
        cameras = ("--camera-rate", "10", "--camera-outputs", "rgb")
        names = [part.partition("=")[0] for part in robots.split(",")] if "=" in robots else [""]
        topics = [f"{name}/cmd_vel".lstrip("/") for name in names]
        # From its first command on, time waits for each policy, and 5 s without one are a pause.
        rules = ";".join(f"policy{k}={topic} every 0.1 from {topic}" for k, topic in enumerate(topics))
        options = ("--scene", scene, "--robot", robots, *more, *cameras, "--lockstep", "--participants", rules)
        self.process = start("gibson_sim.cli.main", "run", *options, log=log)
        self.node = rclpy.create_node("path_following_faults")
        self.log = log
        self.trace: dict[str, list[tuple[float, float, float, float]]] = {}
        """Of each robot: seconds, x, y and speed."""
        self.publishers = {}
        for name, command in zip(names, topics, strict=True):
            self.trace[name] = []
            topic = f"{name}/ground_truth/odom".lstrip("/")
            self.node.create_subscription(
                Odometry, topic, lambda msg, name=name: self._on_truth(name, msg), qos_profile_sensor_data
            )
            self.publishers[name] = self.node.create_publisher(Twist, command, 10)
        self.spin_until(lambda: all(self.trace.values()), "a pose of each robot")

    def _on_truth(self, name: str, msg: Odometry) -> None:
        seconds = msg.header.stamp.sec + 1e-9 * msg.header.stamp.nanosec
        place, speed = msg.pose.pose.position, msg.twist.twist.linear.x
        self.trace[name].append((seconds, place.x, place.y, speed))

    def spin_until(self, holds: Callable[[], bool], what: str) -> None:
        deadline = time.monotonic() + 600.0
        while not holds():
            rclpy.spin_once(self.node, timeout_sec=0.2)
            if self.process.poll() is not None or time.monotonic() > deadline:
                sys.exit(f"error: the simulation gave no {what}; see {self.log}")

    def call(self, name: str, kind: Any, request: Any) -> Any:
        client = self.node.create_client(kind, name)
        self.spin_until(client.service_is_ready, name)
        future = client.call_async(request)
        self.spin_until(future.done, f"answer of {name}")
        return future.result()

    def reset(self) -> None:
        self.call("reset_simulation", ResetSimulation, ResetSimulation.Request())
        for trace in self.trace.values():
            trace.clear()

    def close(self) -> None:
        self.node.destroy_node()
        end(self.process)


def record(simulation: Simulation, folder: Path, robot: str, commands: list[tuple[float, float, float]]) -> None:
    """Records a path of one robot while it is driven by commands: linear, angular, seconds."""
    log = folder.with_suffix(".log")
    recorder = node("path_recorder", robot, log, folder=folder, autostart="true", replace="true", width=96, height=64)
    simulation.spin_until(lambda: "recording" in log.read_text(), "recorder")
    counted = simulation.publishers[robot]
    simulation.spin_until(lambda: counted.get_subscription_count() >= 2, "recorder")
    for linear, angular, seconds in [(0.0, 0.0, 1.0), *commands, (0.0, 0.0, 0.5)]:
        until, command = simulation.trace[robot][-1][0] + seconds, Twist()
        command.linear.x, command.angular.z = linear, angular
        last = -1.0
        while simulation.trace[robot][-1][0] < until:
            if simulation.trace[robot][-1][0] >= last + 0.05:
                last = simulation.trace[robot][-1][0]
                counted.publish(command)
            rclpy.spin_once(simulation.node, timeout_sec=0.2)
    end(recorder)


class Walker:
    """A person who crosses the path when the robot comes near, or who stands on it for a while."""

    def __init__(self, simulation: Simulation, folder: Path, robot: str, stays: bool) -> None:
        nodes = [one.pose for one in load_path(folder).nodes if one.pose is not None]
        x, y, yaw = nodes[len(nodes) * 3 // 5]
        self._at, self._robot, self._stays, self._simulation = (x, y), robot, stays, simulation
        side = (-math.sin(yaw), math.cos(yaw))
        far = [(x + k * side[0], y + k * side[1]) for k in (1.2, -1.2)]
        self._person = Person("person", tuple(far), 0.8, 0.25, 1.7)
        self._since: float | None = None
        self._last: float | None = None
        request = SpawnEntity.Request(name="person", allow_renaming=False)
        (request.entity_resource if hasattr(request, "entity_resource") else request).resource_string = person_urdf(self._person)
        self._put(request.initial_pose, *far[0])
        answer = simulation.call("spawn_entity", SpawnEntity, request)
        if answer.result.result != answer.result.RESULT_OK:
            sys.exit(f"error: {answer.result.error_message}")
        self._move = simulation.node.create_client(SetEntityState, "set_entity_state")

    def _put(self, target: Any, x: float, y: float) -> None:
        target.header.frame_id = "map"
        target.pose.position.x, target.pose.position.y = x, y

    def step(self) -> None:
        seconds, x, y, _ = self._simulation.trace[self._robot][-1]
        if self._since is None and math.dist((x, y), self._at) < 1.3:
            self._since = seconds
        if self._since is None or seconds - self._since > 12.0 or (self._last is not None and seconds < self._last + 0.1):
            return
        self._last, walked = seconds, seconds - self._since
        if self._stays:  # half-way for 6 s, then on
            walked = min(walked, 1.5) if walked < 7.5 else walked - 6.0
        walked = min(walked, 3.0)
        x, y, _ = person_pose(self._person, walked)
        request = SetEntityState.Request(entity="person")
        request.state.header.frame_id = "map"
        request.state.pose.position.x, request.state.pose.position.y = x, y
        request.state.pose.orientation.w = 1.0
        for flag in ("set_pose", "set_twist"):
            if hasattr(request, flag):
                setattr(request, flag, True)
        self._move.call_async(request)

    def close(self) -> None:
        self._simulation.call("delete_entity", DeleteEntity, DeleteEntity.Request(entity="person"))


def follow(simulation: Simulation, out: Path, name: str, paths: dict[str, Path], backend: str) -> None:
    """Drives each robot along its path, and prints a line for each."""
    simulation.reset()
    simulation.spin_until(lambda: all(simulation.trace.values()), "a pose after the reset")
    running, judges = [], {}
    walker = (
        Walker(simulation, next(iter(paths.values())), next(iter(paths)), name == "standing")
        if name in ("person", "standing")
        else None
    )
    for robot, folder in paths.items():
        log = out / f"{name}{robot and '_'}{robot}"
        result = log.with_suffix(".json")
        result.unlink(missing_ok=True)
        faults = FAULTS.get(name, ())
        running.append(
            start(
                "gibson_path_following.nodes.camera_faults", "--ros-args", "-p", "use_sim_time:=true", *faults, "-r", f"__ns:=/{robot}",
                log=log.with_suffix(".faults.log"),
            )
        )  # fmt: skip
        judges[robot] = (
            node("path_evaluator", robot, log.with_suffix(".judge.log"), path=folder, file=result, time_limit=TIME_LIMIT), result
        )  # fmt: skip
        running.append(
            node(
                "path_policy",
                robot,
                log.with_suffix(".policy.log"),
                path=folder,
                backend=backend,
                image_topics="[faulty/image_raw]",
            )
        )

    def done() -> bool:
        if walker is not None:
            walker.step()
        return all(judge.poll() is not None for judge, _ in judges.values())

    simulation.spin_until(done, "end of the drive")
    end(*running)
    if walker is not None:
        walker.close()
    for robot, (_, file) in judges.items():
        print(f"{name + ' ' + robot:14s} {line(json.loads(file.read_text()), simulation.trace[robot])}", flush=True)


def line(result: dict[str, Any], trace: list[tuple[float, float, float, float]]) -> str:
    """Returns what a drive was, in a line."""
    begin = next((k for k, one in enumerate(trace) if one[3] > 0.02), 0)
    stops, k = [], begin
    while k < len(trace):
        if abs(trace[k][3]) < 0.01:
            first = k
            while k < len(trace) and abs(trace[k][3]) < 0.01:
                k += 1
            if k < len(trace) and trace[k - 1][0] - trace[first][0] > 0.3:
                covered = [one for one in trace if trace[begin][0] + 3.0 <= one[0] <= trace[first][0]]
                metres = sum(math.dist(a[1:3], b[1:3]) for a, b in itertools.pairwise(covered))
                at, stood = trace[first][0] - trace[begin][0], trace[k - 1][0] - trace[first][0]
                stops.append(f"stood {stood:.1f} s from second {at:.1f} on, {metres:.2f} m after second 3")
        k += 1
    fastest = max(one[3] for one in trace)
    states = [state for _, state in result["states"]]
    return (
        f"{'arrived' if result['arrived'] else 'not arrived'}, {result['collisions']} collisions, coverage {result['coverage']:.2f}, "
        f"{result['deviation_mean']:.2f} m beside the path, SPL {result['spl']:.2f}, at most {fastest:.2f} m/s; {'; '.join(stops) or 'never stood'}; "
        f"{' '.join(states[:12])}"
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"what happens: {', '.join([*FAULTS, 'robots'])} (default: all)")
    parser.add_argument("--scene", default="harbour_flat")
    parser.add_argument("--robot", default=str(ROBOT), help="name or folder of the robot")
    parser.add_argument("--backend", default="teach_repeat")
    parser.add_argument("--output", type=Path, default=Path("out/path_following_faults"))
    given = parser.parse_args()
    names = given.names or [*FAULTS, "robots"]
    if unknown := set(names) - {*FAULTS, "robots"}:
        parser.error(f"{', '.join(sorted(unknown))}: unknown, must be of {', '.join([*FAULTS, 'robots'])}")
    out: Path = given.output.resolve()
    shutil.rmtree(out / "paths", ignore_errors=True)
    (out / "paths").mkdir(parents=True)
    rclpy.init()
    if alone := [name for name in names if name != "robots"]:
        simulation = Simulation(out / "simulation.log", given.robot, given.scene)
        try:
            record(simulation, out / "paths" / "one", "", [(0.5, -0.05, 6.6)])
            for name in alone:
                follow(simulation, out, name, {"": out / "paths" / "one"}, given.backend)
        finally:
            simulation.close()
    if "robots" in names:
        both = f"left={given.robot},right={given.robot}"
        simulation = Simulation(out / "simulation_robots.log", both, given.scene, "hall;kitchen")
        try:
            for name, turn in (("left", -0.05), ("right", 0.125)):
                record(simulation, out / "paths" / name, name, [(0.5, turn, 4.0)])
            follow(simulation, out, "robots", {name: out / "paths" / name for name in ("left", "right")}, given.backend)
        finally:
            simulation.close()
    rclpy.shutdown()
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except (KeyboardInterrupt, ExternalShutdownException):
        sys.exit(130)
    finally:
        end(*STARTED)
