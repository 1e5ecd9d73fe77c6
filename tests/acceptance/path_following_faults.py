"""Drives a path by images while the camera fails, or a person crosses; says what the robot did. Plain ROS 2 and our package.

After `source env.sh`: python tests/acceptance/path_following_faults.py [NAME ...] [--backend teach_repeat]. It starts the simulation and all nodes
by itself, in lockstep: time waits for images, commands and the person, so calls give the same results, if rarely to the last digit; the nodes of
`dropped` and `delayed` answer no image in particular. Names: plain covered dropped delayed person standing robots; all by default. Exit code 1: a
person was never in the robot's way.
"""

import argparse
import itertools
import json
import math
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Collection, Iterable
from functools import partial
from pathlib import Path
from typing import Any

import rclpy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rclpy.executors import ExternalShutdownException
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo
from simulation_interfaces.srv import GetSimulationState
from std_msgs.msg import Bool, String

from gibson_path_following.paths.path_folder import load_path
from gibson_sim.errors import GibsonSimError
from gibson_sim.ros.client.simulation_client import SimulationClient, flat_pose, move_request, spawn_request
from gibson_sim.ros.lockstep.lockstep_client import LockstepParticipant
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
MET = 1.0
"""Distance between the centres of robot and person, metres, below which they have met. The person starts 1.2 m beside the path."""
ANSWER_S = 5.0
"""Longest wall time that a tick with an image waits for the policy, seconds."""
SETTLED_S = 1.5
"""Wall time for the discovery of new nodes to become complete, seconds."""
IMAGE_TICKS, USED_TICKS, TICKS_HZ = 6, 12, 60
"""Ticks between two images of the camera, and between two that a policy uses (its ``rate_hz``); ticks per second."""
_LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
NODE = "path_following_faults"
"""Name of this program's node, a participant of lockstep."""


def _is_used(seconds: float, first: float | None) -> bool:
    """Returns whether a policy uses the image of a tick; ``first``: time of the first image that it used, None = not yet."""
    if first is None:
        return round(seconds * TICKS_HZ) % IMAGE_TICKS == 0
    return round((seconds - first) * TICKS_HZ) % USED_TICKS == 0


STARTED: dict[subprocess.Popen[bytes], Path] = {}
"""Running processes and their logs."""


def start(module: str, *arguments: str, log: Path) -> subprocess.Popen[bytes]:
    with log.open("w") as out:
        process = subprocess.Popen([sys.executable, "-m", module, *arguments], stdout=out, stderr=subprocess.STDOUT)
    STARTED[process] = log
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
        STARTED.pop(process, None)


class Simulation:
    """A running simulation, and what this program hears of its robots."""

    def __init__(self, log: Path, robots: str, scene: str, starts: str = "") -> None:
        more = ("--start", starts) if starts else ()
        cameras = ("--camera-rate", "10", "--camera-outputs", "rgb")
        names = [part.partition("=")[0] for part in robots.split(",")] if "=" in robots else [""]
        topics = [f"{name}/cmd_vel".lstrip("/") for name in names]
        # From its first command on, time waits for each policy, and 5 s without one are a pause.
        rules = ";".join([NODE, *(f"policy{k}={topic} every 0.1 from {topic}" for k, topic in enumerate(topics))])
        options = ("--scene", scene, "--robot", robots, *more, *cameras, "--lockstep", "--participants", rules)
        self.process = start("gibson_sim.cli.main", "run", *options, log=log)
        self.node = rclpy.create_node(NODE)
        self.log = log
        self.trace: dict[str, list[tuple[float, float, float, float]]] = {}
        """Of each robot: seconds, x, y and speed."""
        self.publishers = {}
        self._infos: dict[str, CameraInfo | None] = {}
        """Calibration of each robot's camera."""
        self.drive: dict[str, Callable[[float], Twist | None]] = {}
        """Robot -> its command at a time, seconds; None = no command is due."""
        self.walker: Walker | None = None
        """The person, who moves at each tick before it ends."""
        for name, command in zip(names, topics, strict=True):
            self.trace[name] = []
            topic = f"{name}/ground_truth/odom".lstrip("/")
            self.node.create_subscription(
                Odometry, topic, lambda msg, name=name: self._on_truth(name, msg), qos_profile_sensor_data
            )
            self.publishers[name] = self.node.create_publisher(Twist, command, 10)
            self.node.create_subscription(Bool, f"{name}/path/lost".lstrip("/"), partial(self._on_view_used, name), 10)
            self.node.create_subscription(Twist, command, partial(self._on_command, name), 10)
            self.node.create_subscription(String, f"{name}/path/state".lstrip("/"), partial(self._on_state, name), _LATCHED)
            self._infos[name] = None
            self.node.create_subscription(
                CameraInfo,
                f"{name}/camera/camera_info".lstrip("/"),
                partial(self._infos.__setitem__, name),
                qos_profile_sensor_data,
            )
        self.services = SimulationClient(self.node, lambda condition, awaited: self.spin_until(condition, str(awaited)))
        self.services.prepare("get_simulation_state")
        self._first = names[0]
        self._policies: dict[str, float | None] = {}
        """Robots whose policies time waits for -> time of the first image that the policy used, seconds; None = not yet."""
        self._unfinished: set[str] = set()
        """What the present tick waits for: ``person``, and robots whose policies have not answered."""
        self._used_ns: dict[str, int] = {}
        """Robots whose policies have used an image and not yet answered -> time of the report of that, ns of wall time."""
        self._commanded_ns: dict[str, int] = {}
        """Time of the newest command of each robot, ns of wall time."""
        self._end_tick: Callable[[], None] = lambda: None
        self._timeout = math.inf
        """When the present tick ends without an answer, seconds of a monotonic clock."""
        self._lockstep = LockstepParticipant(self.node, after=f"{names[0]}/ground_truth/odom".lstrip("/"))
        self.spin_until(lambda: all(self.trace.values()) and all(self._infos.values()), "a pose of each robot")

    def _on_truth(self, name: str, msg: Odometry) -> None:
        seconds = msg.header.stamp.sec + 1e-9 * msg.header.stamp.nanosec
        place, speed = msg.pose.pose.position, msg.twist.twist.linear.x
        if self.trace[name] and seconds < self.trace[name][-1][0]:
            self.trace[name].clear()  # a pose from before a reset
        self.trace[name].append((seconds, place.x, place.y, speed))
        if name == self._first:
            self._tick(msg.header.stamp, seconds)

    def _tick(self, stamp: Any, seconds: float) -> None:
        """Sends the commands that are due and moves the person; the tick ends once that is done and the policies have answered."""
        sent = []
        for robot, drive in self.drive.items():
            if (command := drive(seconds)) is not None:
                self.publishers[robot].publish(command)
                sent.append(self.publishers[robot].topic_name)
        self._end_tick = lambda: self._lockstep.tick_done(stamp, sent)
        self._unfinished = {"tick", *(robot for robot, first in self._policies.items() if _is_used(seconds, first))}
        self._timeout = time.monotonic() + ANSWER_S
        moved = self.walker.step() if self.walker is not None else None
        if moved is not None:
            self._unfinished.add("person")
            moved.add_done_callback(lambda _: self._finish("person"))
        for robot in list(self._policies):
            self._check_answer(robot)  # it may have arrived before the pose of the same tick
        self._finish("tick")

    def _finish(self, part: str) -> None:
        """Marks a part of the present tick as finished; the last one ends the tick."""
        if part in self._unfinished:
            self._unfinished.discard(part)
            if not self._unfinished:
                self._end_tick()

    def _on_view_used(self, robot: str, msg: Bool, info: Any) -> None:
        self._used_ns[robot] = info["source_timestamp"]
        self._check_answer(robot)

    def _on_command(self, robot: str, msg: Twist, info: Any) -> None:
        self._commanded_ns[robot] = info["source_timestamp"]
        self._check_answer(robot)

    def _check_answer(self, robot: str) -> None:
        """Finishes a policy's part of the tick after its answer: the watchdog repeats older commands, and topics may overtake each other."""
        if robot in self._unfinished and self._commanded_ns.get(robot, 0) > self._used_ns.get(robot, math.inf):
            del self._used_ns[robot]
            if self._policies[robot] is None:
                self._policies[robot] = self.trace[robot][-1][0]
            # The command reaches the simulation before this request does: its subscriptions are served before its services.
            self.services.begin("get_simulation_state", GetSimulationState.Request(), lambda _: self._finish(robot))

    def _on_state(self, robot: str, msg: String) -> None:
        if msg.data == "finished":
            self._policies.pop(robot, None)
            self._finish(robot)

    def wait_for_policies(self, robots: Iterable[str]) -> None:
        """Lets time wait for the answers of policies that have used an image; ``()`` = none."""
        self._policies = dict.fromkeys(robots)
        self._used_ns.clear()
        for robot in list(self._unfinished - {"person"}):
            self._finish(robot)

    def _check_timeout(self) -> None:
        """Ends a tick whose policies do not answer, and waits for the next image that they use: images are sent without acknowledgement."""
        late = self._unfinished - {"person"}
        if late and time.monotonic() > self._timeout:
            for robot in late:
                at = self.trace[robot][-1][0]
                print(f"warning: an image of second {at:.1f} was lost; this drive may differ from others", flush=True)
                self._policies[robot] = None
                self._finish(robot)

    def spin_until(self, holds: Callable[[], bool], what: str) -> None:
        deadline = time.monotonic() + 600.0
        while not holds():
            rclpy.spin_once(self.node, timeout_sec=0.2)
            self._check_timeout()
            for process, log in STARTED.items():
                if process.poll():
                    sys.exit(f"error: a node ended with code {process.returncode}; see {log}")
            if self.process.poll() is not None or time.monotonic() > deadline:
                sys.exit(f"error: the simulation gave no {what}; see {self.log}")

    def reset(self) -> None:
        """Resets the simulation, and pauses it at time 0."""
        self.services.pause()
        self.services.reset()

    def play(self, robots: Collection[str], is_ready: Callable[[], bool], camera: str) -> None:
        """Starts time at 0 once the nodes of the robots are ready and discovered.

        Args:
            robots: the robots.
            is_ready: whether their nodes are ready.
            camera: namespace of the images that these use. They get the calibration here; otherwise chance decides whether it or the first
                image comes first, which is then of no use.
        """
        publishers = {
            robot: self.node.create_publisher(CameraInfo, f"{robot}/{camera}/camera_info".lstrip("/"), qos_profile_sensor_data)
            for robot in robots
        }
        self.spin_until(is_ready, "nodes of each robot")
        settled = time.monotonic() + SETTLED_S
        self.spin_until(lambda: time.monotonic() > settled, "discovery")
        for robot, publisher in publishers.items():
            assert self._infos[robot] is not None
            publisher.publish(self._infos[robot])
        for trace in self.trace.values():
            trace.clear()
        self.services.play()
        self.spin_until(lambda: all(self.trace.values()), "a pose of each robot")
        for publisher in publishers.values():
            self.node.destroy_publisher(publisher)

    def has_followers(self, robots: Iterable[str]) -> bool:
        """Returns whether the nodes that follow a path are there: camera faults, policy and evaluator of each robot."""
        counts = (
            (self.node.count_subscribers, "camera/image_raw", 1),
            (self.node.count_subscribers, "faulty/image_raw", 1),
            (self.node.count_subscribers, "ground_truth/odom", 2),
            (self.node.count_publishers, "path/lost", 1),
            (self.node.count_publishers, "cmd_vel", 2),
        )
        return all(count(f"/{robot}/{topic}".replace("//", "/")) >= least for robot in robots for count, topic, least in counts)

    def close(self) -> None:
        self.node.destroy_node()
        end(self.process)


def record(simulation: Simulation, folder: Path, robot: str, commands: list[tuple[float, float, float]]) -> None:
    """Records a path of one robot while it is driven by commands: linear, angular, seconds."""
    simulation.reset()
    log = folder.with_suffix(".log")
    recorder = node("path_recorder", robot, log, folder=folder, autostart="true", replace="true", width=96, height=64)
    counted = simulation.publishers[robot]
    # Commands change between two images: otherwise chance decides which of a command and an image reaches the recorder first.
    steps = [(0.0, 0.0, 1.03), *commands, (0.0, 0.0, 0.5)]
    ends = list(itertools.accumulate(seconds for _, _, seconds in steps))
    last = 0.0

    def drive(now: float) -> Twist | None:
        nonlocal last
        if now < last + 0.05 or now >= ends[-1]:
            return None
        last, command = now, Twist()
        command.linear.x, command.angular.z, _ = next(step for step, until in zip(steps, ends, strict=True) if now < until)
        return command

    simulation.drive[robot] = drive
    simulation.play([robot], lambda: "recording" in log.read_text() and counted.get_subscription_count() >= 2, "camera")
    simulation.spin_until(lambda: simulation.trace[robot][-1][0] >= ends[-1], "end of the recording")
    del simulation.drive[robot]
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
        self._place = far[0]
        self.nearest = math.inf
        """Least distance between the centres of robot and person so far, metres."""
        try:
            simulation.services.ask(
                "spawn_entity", spawn_request(flat_pose(*far[0], 0.0, 0.0), "person", text=person_urdf(self._person))
            )
        except GibsonSimError as error:
            sys.exit(f"error: {error}")
        simulation.services.discover("set_entity_state")

    def step(self) -> Any:
        """Measures the distance to the robot and moves the person; returns the future of that, or None if they stand still."""
        seconds, x, y, _ = self._simulation.trace[self._robot][-1]
        self.nearest = min(self.nearest, math.dist((x, y), self._place))
        if self._since is None and math.dist((x, y), self._at) < 1.3:
            self._since = seconds
        if self._since is None:
            return None
        walked = seconds - self._since
        if self._stays:  # half-way for 6 s, then on
            walked = min(walked, 1.5) if walked < 7.5 else walked - 6.0
        x, y, _ = person_pose(self._person, min(walked, 3.0))
        if (x, y) == self._place:
            return None
        self._place = x, y
        return self._simulation.services.send("set_entity_state", move_request("person", flat_pose(x, y, 0.0, 0.0)))

    def close(self) -> None:
        self._simulation.walker = None
        self._simulation.services.delete("person")


def follow(simulation: Simulation, out: Path, name: str, paths: dict[str, Path], backend: str) -> bool:
    """Drives each robot along its path, and prints a line for each; returns whether the person, if there is one, was in the way."""
    simulation.reset()
    running, judges = [], {}
    walker = None
    if name in ("person", "standing"):
        walker = simulation.walker = Walker(simulation, next(iter(paths.values())), next(iter(paths)), name == "standing")
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

    if name not in ("dropped", "delayed"):  # every image is answered
        simulation.wait_for_policies(paths)
    simulation.play(paths, lambda: simulation.has_followers(paths), "faulty")
    simulation.spin_until(lambda: all(judge.poll() is not None for judge, _ in judges.values()), "end of the drive")
    simulation.wait_for_policies(())
    end(*running)
    if walker is not None:
        walker.close()
    for robot, (_, file) in judges.items():
        rows = ("{:.6f},{:.6f},{:.6f},{:.6f}\n".format(*row) for row in simulation.trace[robot])
        file.with_suffix(".csv").write_text("seconds,x,y,speed\n" + "".join(rows))
        met = "" if walker is None else f"; {walker.nearest:.2f} m from the person at the nearest"
        print(f"{name + ' ' + robot:14s} {line(json.loads(file.read_text()), simulation.trace[robot])}{met}", flush=True)
    if walker is None or walker.nearest < MET:
        return True
    print(
        f"error: {name}: the person was never in the way: {walker.nearest:.2f} m from the robot or more, must be below {MET:g} m"
    )
    return False


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
    parser.add_argument("--backend", default="learned")
    parser.add_argument("--output", type=Path, default=Path("out/path_following_faults"))
    given = parser.parse_args()
    names = given.names or [*FAULTS, "robots"]
    if unknown := set(names) - {*FAULTS, "robots"}:
        parser.error(f"{', '.join(sorted(unknown))}: unknown, must be of {', '.join([*FAULTS, 'robots'])}")
    out: Path = given.output.resolve()
    shutil.rmtree(out / "paths", ignore_errors=True)
    (out / "paths").mkdir(parents=True)
    rclpy.init()
    met = True
    if alone := [name for name in names if name != "robots"]:
        simulation = Simulation(out / "simulation.log", given.robot, given.scene)
        try:
            record(simulation, out / "paths" / "one", "", [(0.5, -0.05, 6.6)])
            for name in alone:
                met &= follow(simulation, out, name, {"": out / "paths" / "one"}, given.backend)
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
    return 0 if met else 1


if __name__ == "__main__":
    try:
        sys.exit(main())
    except (KeyboardInterrupt, ExternalShutdownException):
        sys.exit(130)
    finally:
        end(*list(STARTED))
