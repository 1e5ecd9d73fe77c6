"""Two robots and two render nodes for minutes: no image may be lost, none may be of the other robot, memory must stay flat.

    python tests/benchmarks/soak.py --minutes 5 --json docs/benchmarks/soak_cpu.json --picture docs/images/soak.png

Both robots turn gently, and each rests now and then: while it rests its pictures must not change, while it turns they must.
Reliable readers take every image of both cameras, colour and depth. Exit code 1 where anything is skipped, lost, mixed up or
grows.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import signal
import sys
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from gibson_sim.reach import apply_reach
from support.simulation import Launched, Listener, new_context

ROBOTS = ("left", "right")
STARTS = ((1.0, 4.7), (6.4, 3.3))
"""In the hall and in the kitchen of our flat: they do not see each other."""
STEP_HZ = 240
PHASE_S = 5.0
"""Seconds of simulation time: both turn, left rests, both turn, right rests."""
SETTLING_S = 1.5
"""After a robot was told to stop it may still move for so long, in simulation time."""
SAMPLE_S = 5.0
CHANGED = 0.5
"""Mean change of a pixel, of 255, between two looks, above which it is another view."""
LOOK_EVERY_S = 1.0
WARM_UP = 0.25
"""Part of the run after which memory must stay as it is: caches fill, and Python keeps what it once had."""
ALLOWED_GROWTH_MB = 8.0
"""Between the means of the first and the last third after the warm-up."""


@dataclass
class Stream:
    """What arrived on one image topic."""

    topic: str
    period: int
    """Physics steps between two images."""
    received: int = 0
    missing: int = 0
    """Images between the first and the last that were due and did not arrive."""
    skipped: int = 0
    """Those of them that the renderer had no time to draw, and counted."""
    lost: int = 0
    """The others."""
    out_of_order: int = 0
    last: int = -1

    def add(self, step: int) -> None:
        """Counts an image of a physics step."""
        self.received += 1
        if self.last >= 0:
            self.missing += max(0, (step - self.last) // self.period - 1)
            self.out_of_order += step <= self.last
        self.last = step


@dataclass
class Watch:
    """Looks whether the pictures of a robot change exactly when it moves."""

    robot: int
    looks_at_rest: int = 0
    changed_at_rest: int = 0
    looks_turning: int = 0
    unchanged_turning: int = 0
    _before: tuple[float, NDArray[np.int16]] | None = None

    def look(self, time_s: float, image: Any) -> None:
        """Compares an image with the one before it, where the robot did one and the same thing all the while."""
        if self._before is not None and 0.0 <= time_s - self._before[0] < LOOK_EVERY_S:
            return
        pixels = np.frombuffer(image.data, dtype=np.uint8)[::7].astype(np.int16)
        before, self._before = self._before, (time_s, pixels)
        if before is None or phase(before[0] - SETTLING_S) != phase(time_s):
            return
        changed = float(np.abs(pixels - before[1]).mean()) > CHANGED
        if rests(self.robot, time_s):
            self.looks_at_rest += 1
            self.changed_at_rest += changed
        else:
            self.looks_turning += 1
            self.unchanged_turning += not changed


def phase(time_s: float) -> int:
    """Returns the number of the phase of a simulation time."""
    return int(time_s // PHASE_S)


def rests(robot: int, time_s: float) -> bool:
    """Returns whether a robot is told to stand still at a simulation time."""
    return phase(time_s) % 4 == 1 + 2 * robot


@dataclass
class Memory:
    """Resident memory of processes, MB, over wall time."""

    seconds: list[float] = field(default_factory=list)
    processes: dict[str, list[float]] = field(default_factory=dict)

    def sample(self, seconds: float, pids: dict[str, int]) -> None:
        """Reads the memory of all processes."""
        self.seconds.append(round(seconds, 1))
        for name, pid in pids.items():
            self.processes.setdefault(name, []).append(resident_mb(pid))

    def growth_mb(self, name: str) -> float:
        """Returns how much the mean of the last third is above that of the first third, after the warm-up."""
        values = np.array(self.processes[name][int(len(self.seconds) * WARM_UP) :])
        third = max(1, len(values) // 3)
        return float(values[-third:].mean() - values[:third].mean())


def resident_mb(pid: int) -> float:
    """Returns the resident memory of a process; NaN where it is gone."""
    try:
        text = Path(f"/proc/{pid}/status").read_text()
    except FileNotFoundError:
        return float("nan")
    return next((round(int(line.split()[1]) / 1024, 1) for line in text.splitlines() if line.startswith("VmRSS")), float("nan"))


class Soak:
    """The run: starts everything, drives, listens, measures."""

    def __init__(self, folder: Path, options: argparse.Namespace) -> None:
        from support.clients import LaunchedNode
        from support.robots import write_gibson_bot

        self.options, self.folder = options, folder
        width, _, height = options.size.partition("x")
        camera = {"width": int(width), "height": int(height), "rate_hz": options.camera_rate}
        robot = write_gibson_bot(folder / "robot", camera=camera)
        robots = ",".join(f"{name}={robot}" for name in ROBOTS)
        start = ";".join(f"{x},{y},0" for x, y in STARTS)
        self.run = Launched("run", "--no-render", "--robot", robots, "--start", start, "--rate", str(options.rate))
        self.run.wait_for_line("collision shapes")
        self.renderers = {
            name: LaunchedNode("render", "-r", f"__node:=render_{name}", "-p", f"cameras:={name}/camera", *self._summary(name))
            for name in ROBOTS
        }
        for node in self.renderers.values():
            node.wait_for_line("triangles")
        self.pids = {"physics": self.run.node_pid("physics"), "launcher": self.run.process.pid, "listener": os.getpid()}
        self.pids.update({f"render_{name}": node.process.pid for name, node in self.renderers.items()})
        self.memory = Memory()
        self.streams: list[Stream] = []
        self.watches = [Watch(robot) for robot in range(len(ROBOTS))]
        self.factors: list[float] = []
        self.time_s = 0.0

    def _summary(self, name: str) -> tuple[str, str]:
        """Returns ROS arguments that have a renderer write what it did when it ends."""
        return "-p", f"summary_path:={self.folder / name}.json"

    def listen(self, listener: Listener) -> None:
        """Subscribes to everything, reliably."""
        from rclpy.qos import QoSProfile, ReliabilityPolicy
        from rosgraph_msgs.msg import Clock
        from sensor_msgs.msg import Image
        from std_msgs.msg import Float64

        from support.clients import stamp_ns, step_of

        # Two seconds of images may wait while this process does something else.
        qos = QoSProfile(depth=max(10, int(2 * self.options.camera_rate)), reliability=ReliabilityPolicy.RELIABLE)
        period = round(STEP_HZ / self.options.camera_rate)
        for robot, name in enumerate(ROBOTS):
            for image in ("image_raw", "depth/image_raw"):
                stream = Stream(f"{name}/camera/{image}", period)
                self.streams.append(stream)

                def on_image(message: Any, stream: Stream = stream, robot: int = robot) -> None:
                    stream.add(step_of(stamp_ns(message)))
                    if message.encoding == "rgb8":
                        self.watches[robot].look(stamp_ns(message) / 1e9, message)

                listener.node.create_subscription(Image, stream.topic, on_image, qos)

        def on_clock(message: Clock) -> None:
            self.time_s = stamp_ns(message) / 1e9

        listener.node.create_subscription(Clock, "/clock", on_clock, 10)
        listener.node.create_subscription(Float64, "real_time_factor", lambda m: self.factors.append(m.data), 10)

    def drive(self, listener: Listener, minutes: float) -> None:
        """Drives and measures for so long."""
        from geometry_msgs.msg import Twist

        publishers = [listener.node.create_publisher(Twist, f"{name}/cmd_vel", 1) for name in ROBOTS]
        listener.spin_until(lambda: all(stream.received > 3 for stream in self.streams), "images of both cameras")
        began = sampled = commanded = time.monotonic()
        self.memory.sample(0.0, self.pids)

        def due() -> bool:
            """Sends commands; returns whether the next sample is due."""
            nonlocal commanded
            now = time.monotonic()
            if now - commanded > 0.1:
                commanded = now
                for robot, publisher in enumerate(publishers):
                    publisher.publish(_command(Twist(), robot, self.time_s))
            return now - sampled > SAMPLE_S

        while sampled - began < 60.0 * minutes:
            listener.spin_until(due, "the next sample")
            sampled = time.monotonic()
            self.memory.sample(sampled - began, self.pids)
            print(self.line(), flush=True)

    def line(self) -> str:
        """Returns the state of things in one line."""
        memory = ", ".join(f"{name} {values[-1]:.0f}" for name, values in self.memory.processes.items())
        received, missing = sum(s.received for s in self.streams), sum(s.missing for s in self.streams)
        return f"{self.memory.seconds[-1]:6.0f} s: {received} images, {missing} missing; MB: {memory}"

    def finish(self, listener: Listener) -> None:
        """Ends the renderers, takes what is still under way, and reads what they say of themselves."""
        for node in self.renderers.values():
            node.process.send_signal(signal.SIGINT)
        listener.spin_until(lambda: all(node.process.poll() is not None for node in self.renderers.values()), "end of renderers")
        for stream in self.streams:
            summary = json.loads((self.folder / f"{stream.topic.partition('/')[0]}.json").read_text())
            stream.skipped = min(stream.missing, summary["skipped_images"])
            stream.lost = stream.missing - stream.skipped

    def result(self) -> dict[str, Any]:
        """Returns all figures."""
        looks = {name: asdict(watch) for name, watch in zip(ROBOTS, self.watches, strict=True)}
        for figures in looks.values():
            figures.pop("_before")
            figures.pop("robot")
        return {
            "machine": {"cores": os.cpu_count(), "python": platform.python_version()},
            "camera": f"{self.options.size} at {self.options.camera_rate:g} Hz of simulation time",
            "rate": self.options.rate,
            "wall_time_s": self.memory.seconds[-1],
            "simulation_time_s": self.time_s,
            "real_time_factor_median": float(np.median(self.factors)) if self.factors else 0.0,
            "streams": [asdict(stream) for stream in self.streams],
            "looks": looks,
            "memory_mb": asdict(self.memory),
            "growth_mb": {name: round(self.memory.growth_mb(name), 2) for name in self.memory.processes},
        }

    def close(self) -> None:
        """Ends all processes."""
        for node in self.renderers.values():
            node.stop()
        self.run.stop()


def _command(twist: Any, robot: int, time_s: float) -> Any:
    """Fills a Twist: to and fro about the upright axis, creeping forward and back, or nothing."""
    if not rests(robot, time_s):
        direction = 1.0 if (phase(time_s) // 2) % 2 == 0 else -1.0
        twist.angular.z, twist.linear.x = 0.3 * direction, 0.02 * direction
    return twist


def table(result: dict[str, Any]) -> str:
    """Returns the figures as text."""
    lines = [
        f"{result['wall_time_s']:.0f} s of wall time, {result['simulation_time_s']:.0f} s simulated, "
        f"real-time factor {result['real_time_factor_median']:.2f} (median), cameras {result['camera']}",
        "",
        "| topic | images | skipped by the renderer | lost | out of order |",
        "|---|---|---|---|---|",
        *(f"| {s['topic']} | {s['received']} | {s['skipped']} | {s['lost']} | {s['out_of_order']} |" for s in result["streams"]),
        "",
        "| robot | looks at rest | changed | looks while turning | unchanged |",
        "|---|---|---|---|---|",
        *(
            f"| {n} | {w['looks_at_rest']} | {w['changed_at_rest']} | {w['looks_turning']} | {w['unchanged_turning']} |"
            for n, w in result["looks"].items()
        ),
        "",
        "| process | MB at first | MB at last | growth after warm-up, MB |",
        "|---|---|---|---|",
    ]
    for name, values in result["memory_mb"]["processes"].items():
        lines.append(f"| {name} | {values[0]:.0f} | {values[-1]:.0f} | {result['growth_mb'][name]:+.1f} |")
    return "\n".join(lines)


def problems(result: dict[str, Any]) -> list[str]:
    """Returns what is wrong."""
    found = [f"{s['topic']}: {s['lost']} images lost" for s in result["streams"] if s["lost"]]
    found += [
        f"{s['topic']}: {s['skipped']} images skipped: too much for this machine" for s in result["streams"] if s["skipped"]
    ]
    found += [f"{s['topic']}: {s['out_of_order']} out of order" for s in result["streams"] if s["out_of_order"]]
    for name, looks in result["looks"].items():
        wrong = looks["changed_at_rest"], looks["unchanged_turning"]
        if any(wrong):
            found.append(f"{name}: {wrong[0]} pictures changed while it rested, {wrong[1]} did not while it turned")
    found += [f"{name}: {mb:+.1f} MB" for name, mb in result["growth_mb"].items() if not mb < ALLOWED_GROWTH_MB]
    return found


def write_picture(path: Path, memory: dict[str, Any]) -> None:
    """Draws memory over time."""
    import cv2

    width, height, left, bottom = 800, 360, 60, 40
    canvas = np.full((height, width, 3), 255, dtype=np.uint8)
    seconds, processes = np.array(memory["seconds"]), memory["processes"]
    most = 1.1 * max(np.nanmax(values) for values in processes.values())
    colors = [(180, 80, 20), (40, 120, 220), (40, 160, 40), (160, 40, 160), (90, 90, 90)]

    def point(second: float, mb: float) -> tuple[int, int]:
        x = left + (width - left - 150) * second / max(seconds[-1], 1.0)
        return int(x), int(height - bottom - (height - bottom - 15) * mb / most)

    def write(text: str, x: int, y: int, color: tuple[int, int, int] = (0, 0, 0)) -> None:
        cv2.putText(canvas, text, (x, y), cv2.FONT_HERSHEY_SIMPLEX, 0.42, color, 1, cv2.LINE_AA)

    for mb in range(0, int(most), 100 if most > 300 else 50):
        cv2.line(canvas, point(0, mb), point(seconds[-1], mb), (225, 225, 225), 1)
        write(str(mb), 22, point(0, mb)[1] + 4)
    for second in range(0, int(seconds[-1]) + 1, 60):
        write(f"{second} s", point(second, 0)[0] - 10, height - 20)
    names_at: list[int] = []
    for color, (name, values) in zip(colors, processes.items(), strict=False):
        line = np.array([point(s, v) for s, v in zip(seconds, values, strict=True)], dtype=np.int32)
        cv2.polylines(canvas, [line], False, color, 1, cv2.LINE_AA)
        y = int(line[-1, 1]) + 4
        while any(abs(y - other) < 14 for other in names_at):
            y += 14
        names_at.append(y)
        write(name, int(line[-1, 0]) + 8, y, color)
    write("resident memory, MB", 8, 12)
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), canvas)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=5.0, help="how long, wall time (default: 5)")
    parser.add_argument("--camera-rate", type=float, default=10.0, help="images a second of each camera (default: 10)")
    parser.add_argument("--size", default="640x480", help="of the images (default: 640x480)")
    parser.add_argument("--rate", type=float, default=1.0, help="speed of simulation time (default: 1)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all figures here")
    parser.add_argument("--picture", type=Path, metavar="FILE.png", help="draw memory over time")
    args = parser.parse_args()
    apply_reach(os.environ)
    context = new_context()
    listener = Listener(context)
    with TemporaryDirectory(prefix="gibson-sim-soak-") as folder:
        soak = Soak(Path(folder), args)
        try:
            soak.listen(listener)
            soak.drive(listener, args.minutes)
            soak.finish(listener)
        finally:
            soak.close()
            listener.close()
            context.try_shutdown()
    result = soak.result()
    print(table(result))
    if args.json:
        args.json.parent.mkdir(parents=True, exist_ok=True)
        args.json.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    if args.picture:
        write_picture(args.picture, result["memory_mb"])
    found = problems(result)
    print("\n".join(f"PROBLEM: {problem}" for problem in found) or "no image lost, none mixed up, memory is flat")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
