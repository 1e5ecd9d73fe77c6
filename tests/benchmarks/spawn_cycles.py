"""Thousands of things spawned and deleted in a running simulation: memory and OpenGL objects stay flat, images show what physics has.

    python tests/benchmarks/spawn_cycles.py --cycles 5000 --json docs/benchmarks/spawn_cycles_cpu.json

A physics process and a render process run, a camera looks at six places, and a client asks for everything over simulation_interfaces.
Each cycle spawns one thing (boxes of which no two are alike, meshes with textures of their own, our objects, furniture with joints, now
and then a robot with its cameras) and deletes the oldest. Now and then time is stopped, and the silhouette of every thing in the
image is compared with its triangles where ``get_entity_state`` says that it is. Exit code 1 where anything grows, or does not agree;
fewer than a thousand cycles, in which caches still fill, say nothing of growth.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import time
from collections import Counter, deque
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from gibson_sim.cli.environment import node_environment
from gibson_sim.cli.report_file import write_json
from gibson_sim.geometry.transforms import Mat4, invert, matrix_from_pose
from gibson_sim.reach import apply_reach
from gibson_sim.types import Pose
from gibson_sim_bench import timing
from support.simulation import Launched, Listener, new_context
from support.spawned_things import PLACES, ROBOT, Thing, silhouette, things

COUNT_MODE = "--render-node-that-counts"
SCENE = """\
name: yard
ground_z: 0.0
starts: [{name: far, xy: [-8.0, 0.0], yaw_deg: 180.0}]
objects:
  - {name: board, box: [12.0, 12.0, 0.1], pose: {xyz: [0.0, 0.0, -0.5]}, semantic_class: floor}
"""
"""The board lies below the ground plane: it must not hide what lands, which may dip into the ground for a moment."""
VIEWS = """\
cameras:
  - {name: eye, link: map, pose: {xyz: [-1.5, 0.0, 1.9], rpy_deg: [0.0, 52.0, 0.0]}, width: 960, height: 720, rate_hz: 30,
     fov_y_deg: 55.0, outputs: [instance]}
"""
CAMERA = "eye"
STEPS_PER_IMAGE = 8
"""Physics steps between two images."""
SMALLEST = 200
"""Pixels below which a silhouette is too small to say much."""
WANTED_IOU = 0.995
ENOUGH = 1000
"""Cycles after which growth is growth."""
WARM_UP = 0.2
"""Part of the run after which memory must stay as it is: caches fill."""
ALLOWED_GROWTH_MB = 8.0
"""Between the means of the first and the last third after the warm-up, in a run of few cycles; in a long one, ..."""
ALLOWED_KB_A_CYCLE = 4.0
"""... as PyBullet keeps 1 to 3 KB of every body that it let go."""


@dataclass
class Figures:
    """What was measured along the way."""

    cycles: list[int] = field(default_factory=list)
    memory_mb: dict[str, list[float]] = field(default_factory=dict)
    files: dict[str, list[int]] = field(default_factory=dict)
    threads: dict[str, list[int]] = field(default_factory=dict)
    gl_objects: list[dict[str, int]] = field(default_factory=list)
    ious: list[float] = field(default_factory=list)
    worst: str = ""
    images: int = 0

    def sample(self, cycle: int, pids: dict[str, int], counts: Path) -> None:
        """Reads memory, open files and threads of all processes, and how many OpenGL objects there are."""
        self.cycles.append(cycle)
        for name, pid in pids.items():
            status = dict(line.split(":", 1) for line in Path(f"/proc/{pid}/status").read_text().splitlines())
            self.memory_mb.setdefault(name, []).append(round(int(status["VmRSS"].split()[0]) / 1024, 1))
            self.files.setdefault(name, []).append(len(os.listdir(f"/proc/{pid}/fd")))
            self.threads.setdefault(name, []).append(int(status["Threads"]))
        self.gl_objects.append(json.loads(counts.read_text()))

    def growth(self, values: list[Any]) -> float:
        """Returns how much the mean of the last third is above that of the first third, after the warm-up."""
        late = np.array(values[int(len(values) * WARM_UP) :], dtype=np.float64)
        third = max(1, len(late) // 3)
        return float(late[-third:].mean() - late[:third].mean())


class CountingRenderNode(Launched):
    """A render node that keeps count of its OpenGL objects in a file."""

    def __init__(self, counts: Path) -> None:
        self._start([sys.executable, "-u", __file__, COUNT_MODE, str(counts)], {**node_environment()})


def render_and_count(counts: Path) -> None:
    """Runs a render node; ``counts`` says, after every change of the scene, how many OpenGL objects of each kind there are."""
    from gibson_sim.render.context.gl import Gl
    from gibson_sim.render.renderer import Renderer
    from gibson_sim.ros.nodes import render_node

    alive: Counter[str] = Counter()
    create, delete, update = Gl.create, Gl.delete, Renderer.update

    def kind(function: str) -> str:
        return function.removeprefix("glCreate").removeprefix("glGen").removeprefix("glDelete").lower()

    def counted_create(self: Gl, function: str, *arguments: int) -> int:
        alive[kind(function)] += 1
        return create(self, function, *arguments)

    def counted_delete(self: Gl, function: str, name: int) -> None:
        alive[kind(function)] -= 1
        delete(self, function, name)

    def counted_update(self: Renderer, *arguments: Any, **options: Any) -> bool:
        result = update(self, *arguments, **options)
        fresh = counts.with_suffix(".new")
        fresh.write_text(json.dumps(alive))
        fresh.replace(counts)
        return result

    Gl.create, Gl.delete, Renderer.update = counted_create, counted_delete, counted_update  # type: ignore[method-assign]
    counts.write_text("{}")
    render_node.main([])


class Run:
    """The simulation, and a client of it."""

    def __init__(self, folder: Path, seed: int) -> None:
        from support.clients import client_of

        (folder / "yard").mkdir()
        (folder / "yard" / "scene.yaml").write_text(SCENE)
        (folder / "views.yaml").write_text(VIEWS)
        scene, views = str(folder / "yard"), str(folder / "views.yaml")
        self.counts = folder / "gl_objects.json"
        self.simulation = Launched("run", "--no-render", "--scene", scene, "--robot", ROBOT, "--views", views)
        self.render = CountingRenderNode(self.counts)
        self.context = new_context()
        self.listener = Listener(self.context)
        self.things, self.alive = things(folder, np.random.default_rng(seed)), deque[Thing]()
        self.figures = Figures()
        self._services = client_of(self.listener)
        self._images: deque[Any] = deque(maxlen=30)
        self._names: dict[int, str] = {}
        self._T_map_camera: Mat4 | None = None
        self._matrix: NDArray[np.float64] | None = None
        self._subscribe()
        self.simulation.wait_for_line("collision shapes")
        self.listener.spin_until(lambda: bool(self._images) and self._matrix is not None, "an image")
        self.listener.spin_until(lambda: self._T_map_camera is not None, "the pose of the camera")
        self.pids = {"physics": self.simulation.node_pid("physics"), "render": self.render.process.pid, "client": os.getpid()}

    def _subscribe(self) -> None:
        from sensor_msgs.msg import CameraInfo, Image
        from tf2_msgs.msg import TFMessage

        from gibson_sim.ros.conversions.images import label_info_type
        from support.clients import LATCHED

        def on_image(message: Any) -> None:
            self.figures.images += 1
            self._images.append(message)

        def on_labels(message: Any) -> None:
            self._names = {one.class_id: one.class_name for one in message.class_map}

        def on_info(message: Any) -> None:
            self._matrix = np.array(message.k).reshape(3, 3)

        def on_transforms(message: Any) -> None:
            for one in message.transforms:
                if one.child_frame_id == f"{CAMERA}_optical_frame":
                    self._T_map_camera = _matrix(one.transform.translation, one.transform.rotation)

        node = self.listener.node
        node.create_subscription(Image, f"{CAMERA}/instance/image_raw", on_image, 5)
        node.create_subscription(label_info_type(), f"{CAMERA}/instance/label_info", on_labels, LATCHED)
        node.create_subscription(CameraInfo, f"{CAMERA}/instance/camera_info", on_info, 5)
        node.create_subscription(TFMessage, "/tf", on_transforms, 10)

    def cycle(self) -> None:
        """Spawns the next thing and deletes the oldest."""
        from geometry_msgs.msg import Point, Pose as PoseMessage, PoseStamped, Quaternion

        thing = next(self.things)
        if len(self.alive) == len(PLACES):
            self._services.ask("delete_entity", entity=self.alive.popleft().name)
        x, y, z = thing.place
        turn = Quaternion(z=math.sin(thing.yaw / 2), w=math.cos(thing.yaw / 2))
        start = PoseStamped(pose=PoseMessage(position=Point(x=x, y=y, z=z), orientation=turn))
        fields = {"entity_namespace": thing.name} if thing.is_robot else {}
        self._services.ask(
            "spawn_entity", name=thing.name, uri=thing.uri, resource_string=thing.text, initial_pose=start, **fields
        )
        self.alive.append(thing)

    def compare(self) -> None:
        """Stops time, and compares the next image with what physics says; lets time go on."""
        from support.clients import stamp_ns, step_of

        self._services.pause()
        now = step_of(stamp_ns(self._services.ask("get_entity_state", entity=self.alive[0].name).state))
        # The image after the next one, so that it was drawn after all that was asked for.
        target = (now // STEPS_PER_IMAGE + 2) * STEPS_PER_IMAGE
        self._services.step(target - now)
        masks = self._masks()
        self.listener.spin_until(lambda: any(step_of(stamp_ns(image)) == target for image in self._images), "the image")
        wanted = {thing.name for thing in self.alive}
        self.listener.spin_until(lambda: wanted <= set(self._names.values()), "the numbers of all things")
        numbers = {name: number for number, name in self._names.items()}
        image = next(image for image in self._images if step_of(stamp_ns(image)) == target)
        pixels = np.frombuffer(image.data, dtype=np.uint16).reshape(image.height, image.width)
        for name, mask in masks.items():
            # What hides others, or is hidden by them, counts for nobody.
            clear = ~np.logical_or.reduce([other for key, other in masks.items() if key != name] or [np.zeros_like(mask)])
            expected, seen = mask & clear, (pixels == numbers[name]) & clear
            if expected.sum() >= SMALLEST:
                iou = float((expected & seen).sum() / (expected | seen).sum())
                if not self.figures.ious or iou < min(self.figures.ious):
                    what = next(thing.uri or "box" for thing in self.alive if thing.name == name)
                    self.figures.worst = f"{name} ({Path(what).name}): {iou:.4f} of {int(expected.sum())} pixels"
                self.figures.ious.append(iou)
        self._services.play()

    def _masks(self) -> dict[str, NDArray[np.bool_]]:
        """Returns where each thing without joints must be seen, (H, W)."""
        assert self._matrix is not None and self._T_map_camera is not None
        height, width = self._images[-1].height, self._images[-1].width
        masks = {}
        for thing in self.alive:
            triangles = thing.triangles()
            if triangles is not None:
                at = self._services.ask("get_entity_state", entity=thing.name).state.pose
                T_camera_body = invert(self._T_map_camera) @ _matrix(at.position, at.orientation)
                masks[thing.name] = silhouette(triangles, T_camera_body, self._matrix, (height, width))
        return masks

    def close(self) -> None:
        """Ends everything."""
        self.render.stop()
        self.simulation.stop()
        self.listener.close()
        self.context.try_shutdown()


def _matrix(position: Any, quat: Any) -> Mat4:
    return matrix_from_pose(Pose((position.x, position.y, position.z), (quat.x, quat.y, quat.z, quat.w)))


def problems(result: dict[str, Any]) -> list[str]:
    """Returns what is wrong."""
    found = []
    if result["cycles"] >= ENOUGH:
        allowed = max(ALLOWED_GROWTH_MB, ALLOWED_KB_A_CYCLE * result["cycles"] * (1.0 - WARM_UP) * 2.0 / 3.0 / 1024.0)
        found += [f"{name}: {mb:+.1f} MB" for name, mb in result["growth_mb"].items() if name != "client" and not mb < allowed]
        found += [f"{name}: {count:+.1f} open files" for name, count in result["growth_files"].items() if not count < 1.0]
        found += [f"OpenGL {kind}: {count:+.1f}" for kind, count in result["growth_gl_objects"].items() if not count < 1.0]
    if not result["iou_min"] > WANTED_IOU:
        found.append(f"silhouettes: the worst is {result['worst']}")
    return found


def report(figures: Figures, cycles: int, seconds: float) -> dict[str, Any]:
    """Returns all figures."""
    kinds = sorted({kind for counts in figures.gl_objects for kind in counts})
    return {
        "date": timing.now(),
        "version": timing.version(),
        "machine": timing.machine(),
        "cores": timing.cores(),
        "cycles": cycles,
        "wall_time_s": round(seconds, 1),
        "images": figures.images,
        "silhouettes": len(figures.ious),
        "iou_min": min(figures.ious, default=0.0),
        "iou_mean": float(np.mean(figures.ious)) if figures.ious else 0.0,
        "worst": figures.worst,
        "growth_mb": {name: round(figures.growth(values), 2) for name, values in figures.memory_mb.items()},
        "growth_files": {name: round(figures.growth(values), 2) for name, values in figures.files.items()},
        "growth_gl_objects": {kind: round(figures.growth([c.get(kind, 0) for c in figures.gl_objects]), 2) for kind in kinds},
        "at_cycle": figures.cycles,
        "memory_mb": figures.memory_mb,
        "open_files": figures.files,
        "threads": figures.threads,
        "gl_objects": {kind: [counts.get(kind, 0) for counts in figures.gl_objects] for kind in kinds},
    }


def main() -> int:
    """Returns the exit code."""
    if sys.argv[1:2] == [COUNT_MODE]:
        render_and_count(Path(sys.argv[2]))
        return 0
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cycles", type=int, default=5000, help="spawned and deleted so often (default: 5000)")
    parser.add_argument("--compare-every", type=int, default=50, help="cycles between two looks at an image (default: 50)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all figures here")
    args = parser.parse_args()
    apply_reach(os.environ)
    with TemporaryDirectory(prefix="gibson-sim-spawning-") as folder:
        run = Run(Path(folder), args.seed)
        began = time.monotonic()
        try:
            for cycle in range(args.cycles):
                run.cycle()
                if (cycle + 1) % args.compare_every == 0:
                    run.compare()
                    run.figures.sample(cycle + 1, run.pids, run.counts)
                    memory = ", ".join(f"{name} {values[-1]:.0f}" for name, values in run.figures.memory_mb.items())
                    gl = ", ".join(f"{count} {kind}" for kind, count in run.figures.gl_objects[-1].items())
                    worst = min(run.figures.ious, default=float("nan"))
                    print(f"{cycle + 1}: MB: {memory}; {gl}; worst IoU {worst:.4f}", flush=True)
        finally:
            run.close()
    result = report(run.figures, args.cycles, time.monotonic() - began)
    write_json(args.json, result)
    found = problems(result)
    good = f"nothing grows; {result['silhouettes']} silhouettes agree, the worst by {result['iou_min']:.4f}"
    print("\n".join(f"PROBLEM: {problem}" for problem in found) or good)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
