"""Draws poses of scenes by our renderer and by path tracing, and compares the pictures."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import ConfigError
from gibson_sim.geometry.transforms import invert, matrices_from_poses, matrix_from_pose, quat_from_matrix
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.quoting import duration_text
from gibson_sim.render.cache import default_folder
from gibson_sim.render.renderer import MeshFiles, Renderer
from gibson_sim.robots.load import load_robot
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.scenes.load import load_scene, with_robots
from gibson_sim.scenes.spec import DrawnScene, SceneSpec, drawn_scene
from gibson_sim.sensors.image_similarity import psnr, ssim_map
from gibson_sim.types import Frame, Pose, SceneState
from gibson_sim_bench import timing
from gibson_sim_bench.realism.causes import CAUSES, MOVING, OUTSIDE, CauseError, errors_by_cause, masks_of
from gibson_sim_bench.realism.measures import flip_map
from gibson_sim_bench.realism.poses import Arrangement, body_poses, sample_arrangements
from gibson_sim_bench.ros import without_nan
from gibson_sim_tools.making.baking import check_blender
from gibson_sim_tools.tracing.export import traced_scene
from gibson_sim_tools.tracing.pictures import Outside, curve_of, developed, exposure_samples, fit_exposure, noise_of
from gibson_sim_tools.tracing.tracer import CyclesTracer, TracedPicture

F64 = NDArray[np.float64]
Rgb = NDArray[np.uint8]
ROBOT = "gibson_bot"
_HIDDEN = Pose((0.0, 0.0, -50.0))
"""Pose of the robot where it is not in sight."""
_GLASS = 2
_DEPTH_M, _DEPTH_SHARE = 0.03, 0.01
"""Difference of two depths up to which they agree: metres, and as a share of the depth."""


@dataclass(frozen=True, slots=True)
class RealismPlan:
    """What to measure."""

    scenes: tuple[str, ...]
    poses: int = 12
    """Poses of each scene."""
    seed: int = 0
    width: int = 320
    """Width of the pictures, pixels; their height is three quarters of it."""
    samples: int = 128
    """Paths per pixel of the traced pictures."""
    antialiasing: int = 1
    """Colour samples per pixel of our pictures: 1, the default of cameras, or 4."""
    blender_python: str = sys.executable
    repeat_truth: bool = False

    def __post_init__(self) -> None:
        if not self.scenes:
            raise ConfigError("no scene is given; name one or more, such as linden_flat")
        for name, low, high in (("poses", 1, 10_000), ("seed", 0, 2**31 - 1), ("width", 64, 4096), ("samples", 2, 65_536)):
            if not low <= getattr(self, name) <= high:
                raise ConfigError(f"--{name} is {getattr(self, name)}, must be {low} to {high}")
        if self.width % 4:
            raise ConfigError(f"--width is {self.width}, must be a multiple of 4: the height is three quarters of it")
        if self.antialiasing not in (1, 4):
            raise ConfigError(f"--antialiasing is {self.antialiasing}, must be 1 or 4")


@dataclass(frozen=True, slots=True, eq=False)
class Pair:
    """Two pictures of one pose, (H, W, 3), sRGB."""

    ours: Rgb
    truth: Rgb


@dataclass(frozen=True, slots=True)
class PoseResult:
    """The comparison of one pose."""

    where: str
    """Room, x and y (m), heading and height of the camera."""
    robot: bool
    """Whether the robot is in sight."""
    moved: tuple[str, ...]
    """Names of the bodies that were moved since the bake."""
    psnr: float
    """Of all pixels, dB."""
    psnr_inside: float
    """Of all pixels but those of the view outside, dB."""
    ssim: float
    flip: float
    """Mean FLIP difference, 0 = equal."""
    noise_psnr: float
    """Of the traced picture against a noiseless one, before denoising, dB: the figures above cannot be trusted near it."""
    same_depth: float
    """Share of the pixels whose depths agree; the rest are edges, or errors of the exporter."""
    causes: dict[str, CauseError]


@dataclass(frozen=True, slots=True)
class SceneResult:
    """The comparison of all poses of a scene."""

    scene: str
    generated: bool
    """Whether its plan, materials and lamps were traced; else its mesh files."""
    exposure: tuple[float, float, float]
    """Factors of red, green and blue for all traced pictures of the scene, fitted to ours: exposure and white balance."""
    poses: tuple[PoseResult, ...]
    warnings: tuple[str, ...] = ()
    pairs: tuple[Pair, ...] = field(default=(), repr=False, compare=False)

    @property
    def summary(self) -> dict[str, float]:
        """Means over the poses, the worst tenth and the worst; PSNR of what moves and of what does not, over all pixels; share of each cause."""
        psnrs = sorted(pose.psnr for pose in self.poses)
        flips = [pose.flip for pose in self.poses]
        found = {
            "psnr": float(np.mean(psnrs)),
            "psnr_worst_tenth": float(np.mean(psnrs[: max(1, len(psnrs) // 10)])),
            "psnr_worst": psnrs[0],
            "psnr_inside": float(np.mean([pose.psnr_inside for pose in self.poses])),
            "psnr_moves": _pooled_psnr(self.poses, (MOVING,)),
            "psnr_still": _pooled_psnr(self.poses, tuple(cause for cause in CAUSES if cause not in (MOVING, OUTSIDE))),
            "ssim": float(np.mean([pose.ssim for pose in self.poses])),
            "flip": float(np.mean(flips)),
            "flip_worst": float(max(flips)),
            "noise_psnr": float(np.mean([pose.noise_psnr for pose in self.poses])),
            "same_depth": float(np.mean([pose.same_depth for pose in self.poses])),
        }
        amounts = {cause: sum(_amount(pose, cause) for pose in self.poses) for cause in CAUSES}
        total = sum(amounts.values())
        found |= {f"share_{cause}": amount / total if total else 0.0 for cause, amount in amounts.items()}
        return {name: round(value, 4) for name, value in found.items()}


def _amount(pose: PoseResult, cause: str) -> float:
    return pose.causes[cause].pixels * pose.causes[cause].mse


def _pooled_psnr(poses: Sequence[PoseResult], causes: Sequence[str]) -> float:
    """Returns the PSNR over all pixels of some causes, dB; NaN without pixels. Light and texture share their pixels."""
    pixels = sum(pose.causes[cause].pixels for pose in poses for cause in causes if cause != "light")
    return psnr(sum(_amount(pose, cause) for pose in poses for cause in causes) / pixels) if pixels else float("nan")


@dataclass(frozen=True, slots=True)
class RealismReport:
    """All scenes, with the machine."""

    facts: timing.Facts
    plan: RealismPlan
    scenes: tuple[SceneResult, ...]
    wall_s: float

    def as_json(self) -> dict[str, Any]:
        """Returns the report as JSON types, without the pictures; NaN becomes null."""
        scenes = []
        for scene in self.scenes:
            values = {name: getattr(scene, name) for name in ("scene", "generated", "exposure", "warnings")}
            scenes.append({**values, "summary": scene.summary, "poses": [asdict(pose) for pose in scene.poses]})
        figures = [
            {"name": f"{scene.scene}: {name}", "value": scene.summary[key], "unit": unit, "better": better}
            for scene in self.scenes
            for name, key, unit, better in (
                ("PSNR, mean", "psnr", "dB", "more"),
                ("PSNR, worst tenth", "psnr_worst_tenth", "dB", "more"),
                ("FLIP, mean", "flip", "", "less"),
            )
        ]
        plan = {name: value for name, value in asdict(self.plan).items() if name not in ("blender_python", "repeat_truth")}
        found: dict[str, Any] = without_nan(
            {
                "kind": "realism",
                "facts": asdict(self.facts),
                "plan": plan,
                "wall_s": round(self.wall_s, 1),
                "scenes": scenes,
                "figures": figures,
            }
        )
        return found


def measure(plan: RealismPlan, progress: Callable[[str], None] = lambda line: None) -> RealismReport:
    """Returns the measurements.

    Args:
        plan: what to measure.
        progress: called with one line of progress.

    Raises:
        GibsonSimError: Blender is missing or failed, a scene cannot be loaded, or its plan is not that of this version.
    """
    check_blender(plan.blender_python)
    facts, started = timing.facts(), time.monotonic()
    scenes = tuple(_measured(name, plan, progress) for name in plan.scenes)
    return RealismReport(facts, plan, scenes, time.monotonic() - started)


def _measured(name: str, plan: RealismPlan, progress: Callable[[str], None]) -> SceneResult:
    progress(f"{name}: loading")
    scene, robot = load_scene(name), load_robot(ROBOT)
    arrangements = sample_arrangements(
        scene, plan.poses, plan.seed, robot_radius=robot.radius, width=plan.width, samples=plan.antialiasing
    )
    with_robot = with_robots(scene, [robot])
    T_base_links = _robot_links(robot)
    links = (*T_base_links, *(f"{body.name}/{link}" for body in scene.bodies for link in body.links))
    drawn = drawn_scene(with_robot, links)
    states = [_state(drawn, arrangement, T_base_links) for arrangement in arrangements]
    with Renderer(drawn, meshes=MeshFiles(cache=default_folder())) as renderer:
        frames = [
            renderer.render(state, [arrangement.camera])[0] for state, arrangement in zip(states, arrangements, strict=True)
        ]
    traced = traced_scene(drawn)
    with CyclesTracer(traced, plan.blender_python, plan.samples, repeat=plan.repeat_truth) as tracer:
        pictures = _traced(tracer, frames, states, plan.seed, name, progress)
    return _compared(scene, arrangements, frames, pictures, generated=traced.building is not None, warnings=traced.warnings)


def _robot_links(robot: RobotSpec) -> dict[str, F64]:
    """Returns T_base_link of the links of a robot with its joints as at load, by ``<robot>/<link>``."""
    empty = SceneSpec("empty", Path("/"), "", (), (), ground_z=0.0)
    with PhysicsWorld(with_robots(empty, [replace(robot, start=Pose())])) as world:
        state = world.state()
    T_world_links = matrices_from_poses(state.positions, state.quats_xyzw)
    T_base_world = invert(T_world_links[state.links.index(f"{robot.name}/{robot.base_link}")])
    return {link: T_base_world @ T for link, T in zip(state.links, T_world_links, strict=True)}


def _state(drawn: DrawnScene, arrangement: Arrangement, T_base_links: dict[str, F64]) -> SceneState:
    """Returns the state of a scene in which everything is where an arrangement has it."""
    T_world_base = matrix_from_pose(arrangement.robot or _HIDDEN)
    poses = {link: T_world_base @ T for link, T in T_base_links.items()} | body_poses(arrangement.bodies)
    T = np.stack([poses[link] for link in drawn.links])
    quats = np.array([quat_from_matrix(rotation) for rotation in T[:, :3, :3]])
    return SceneState(0, 0, drawn.revision, drawn.links, T[:, :3, 3].copy(), quats, np.zeros((len(T), 6)))


def _traced(
    tracer: CyclesTracer,
    frames: Sequence[Frame],
    states: Sequence[SceneState],
    seed: int,
    name: str,
    progress: Callable[[str], None],
) -> list[TracedPicture]:
    todo = sum(
        not tracer.is_cached(frame.camera, frame.T_world_camera, state, seed) for frame, state in zip(frames, states, strict=True)
    )
    progress(f"{name}: {len(frames) - todo} traced pictures are cached, {todo} are to be traced")
    pictures, done, first_s = [], 0, time.monotonic()
    for frame, state in zip(frames, states, strict=True):
        is_new = not tracer.is_cached(frame.camera, frame.T_world_camera, state, seed)
        pictures.append(tracer.picture(frame.camera, frame.T_world_camera, state, seed))
        if is_new:
            done += 1
            left_s = (time.monotonic() - first_s) / done * (todo - done)
            progress(f"{name}: picture {done} of {todo} traced, {duration_text(left_s)} left")
    return pictures


def _compared(
    scene: SceneSpec,
    arrangements: Sequence[Arrangement],
    frames: Sequence[Frame],
    pictures: Sequence[TracedPicture],
    *,
    generated: bool,
    warnings: tuple[str, ...],
) -> SceneResult:
    curve, outside = curve_of(generated=generated), Outside.of(scene.light)
    masks = [masks_of(picture.moving, picture.alpha, picture.material) for picture in pictures]
    ours = [_rgb_of(frame) for frame in frames]
    used = [mask["light"] & (picture.alpha > 0.999) for mask, picture in zip(masks, pictures, strict=True)]
    factors = fit_exposure(*exposure_samples(list(zip(pictures, ours, strict=True)), used), curve)
    results, pairs = [], []
    for arrangement, frame, image, picture, mask in zip(arrangements, frames, ours, pictures, masks, strict=True):
        seen = outside.seen(frame.camera, frame.T_world_camera)
        truth = developed(picture, factors, curve, seen)
        squares = ((image.astype(np.float64) - truth) ** 2).mean(axis=2)
        inside = ~mask[OUTSIDE]
        results.append(
            PoseResult(
                arrangement.text, arrangement.robot is not None, arrangement.moved, psnr(float(squares.mean())),
                psnr(float(squares[inside].mean())) if inside.any() else float("nan"), float(ssim_map(image, truth).mean()),
                float(flip_map(truth, image).mean()), psnr(noise_of(picture, factors, curve, seen)),
                same_depth(frame, picture), errors_by_cause(image, truth, mask),
            )
        )  # fmt: skip
        pairs.append(Pair(image, truth))
    exposure = (float(factors[0]), float(factors[1]), float(factors[2]))
    return SceneResult(scene.name, generated, exposure, tuple(results), warnings, tuple(pairs))


def _rgb_of(frame: Frame) -> Rgb:
    assert frame.rgb is not None
    return frame.rgb


def same_depth(frame: Frame, picture: TracedPicture) -> float:
    """Returns the share of the pixels, without those of glass, whose depth is that of the traced picture there or at a neighbour."""
    assert frame.depth is not None
    limit = 1e4
    ours, theirs = (np.minimum(depth, limit).astype(np.float32) for depth in (frame.depth, picture.depth))
    kernel = np.ones((3, 3), dtype=np.uint8)
    tolerance = _DEPTH_M + _DEPTH_SHARE * ours
    agrees = (cv2.erode(theirs, kernel) - tolerance <= ours) & (ours <= cv2.dilate(theirs, kernel) + tolerance)
    counted = picture.material != _GLASS
    return float(agrees[counted].mean()) if counted.any() else 1.0
