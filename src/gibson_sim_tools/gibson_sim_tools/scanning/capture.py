"""Captures a scan: plans it, renders it, adds defects, and writes a folder. An interrupted scan resumes where it stopped.

    scan.json        the scene, every setting, and the views; ``frames`` = number of images
    color/000000.jpg sRGB
    depth/000000.png 16 bit, millimetres along the optical axis, 0 = no depth; registered with the colours
    poses.txt        estimated camera poses: rows ``stamp tx ty tz qx qy qz qw`` of T_world_camera, optical frame
    true_poses.txt   true camera poses
    trajectory.log   as poses.txt, for Open3D
    intrinsic.json   Open3D's format

The world frame is that of the scene, z up.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim import __version__
from gibson_sim.geometry.transforms import R_LINK_OPTICAL, matrix_from_pose, pose_from_matrix, pose_from_xyz_rpy
from gibson_sim.picture_files import write_picture
from gibson_sim.render.renderer import MeshFiles, Renderer
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim.types import NS_PER_S, CameraSpec, Frame, Output, SceneState
from gibson_sim.writing import write_file
from gibson_sim_tools.scanning.clean_scene import opaque_triangles, sample_surface, static_scene
from gibson_sim_tools.scanning.defects import estimated_poses, image_effects, measured_depth
from gibson_sim_tools.scanning.intrinsics_files import write_intrinsics
from gibson_sim_tools.scanning.layouts import DESCRIPTION, FORMAT, read_json
from gibson_sim_tools.scanning.posed_images import Intrinsics, ScanError, depth_units
from gibson_sim_tools.scanning.route import RigView, plan_views
from gibson_sim_tools.scanning.settings import Defects, ScanCamera, TourSettings
from gibson_sim_tools.scanning.stations import candidate_stations, find_storeys, select_stations
from gibson_sim_tools.scanning.trajectories import write_stamped_poses, write_trajectory_log

F64 = NDArray[np.float64]
Progress = Callable[[float], None]

DEPTH_SCALE = 1000.0
SURFACE_POINTS = 30_000
"""Number of surface samples that measure the coverage."""
_BATCH_SIZE = 6
"""Number of views rendered in one call."""
_MAX_VIEWS = 1_000_000
_SHUTTER_LEAD_S = 0.1
"""Age of the earlier state that motion blur interpolates from, seconds."""


@dataclass(frozen=True, slots=True)
class ScanSettings:
    """All settings of a scan."""

    tour: TourSettings
    camera: ScanCamera
    defects: Defects


@dataclass(frozen=True, slots=True, eq=False)
class ScanPlan:
    """Views of the rig, and the coverage of its stations."""

    views: tuple[RigView, ...]
    stations: int
    coverage: float
    """Fraction of the surface visible from free positions that is visible from the stations, 0 to 1."""


def scan(
    scene: SceneSpec, folder: Path, settings: ScanSettings, *, cache: Path | None = None, progress: Progress = lambda _: None
) -> ScanPlan:
    """Captures a scan of a scene, or the rest of an interrupted one, and returns its plan.

    Args:
        scene: scene to scan, without its robots.
        folder: output folder: new, empty, or with an interrupted scan of the same settings.
        settings: settings of the scan.
        cache: cache folder of ``Renderer``.
        progress: called with the fraction that is done, 0 to 1.

    Raises:
        ScanError: the folder holds something else, or the rig fits nowhere.
        GibsonSimError: the scene cannot be rendered.
    """
    resumed_plan = _resumed_plan(folder, scene, settings)
    links = tuple(f"scanner/{k}" for k in range(_BATCH_SIZE))
    static = static_scene(scene, links)
    with Renderer(static, meshes=MeshFiles(cache=cache)) as renderer:
        plan = resumed_plan or _plan(scene, settings, _RigRenderer(renderer, static.revision, links), progress)
        if resumed_plan is None:
            _write_headers(folder, scene, settings, plan)
        _Capture(
            folder,
            settings,
            plan,
            _RigRenderer(renderer, static.revision, links),
            _shiny_class_ids(static.semantic_classes, settings.defects),
        ).run(progress)
    return plan


class _RigRenderer:
    """Renderer with one rig link per view of a batch, so that each view has its own pose and motion blur."""

    def __init__(self, renderer: Renderer, revision: int, links: tuple[str, ...]) -> None:
        self._renderer, self._revision, self.links = renderer, revision, links

    def depths(self, cameras: Sequence[CameraSpec]) -> list[NDArray[np.float32]]:
        """Returns the depth images of cameras fixed to the world."""
        frames = self._renderer.render(self._state([np.eye(4)] * len(self.links), 0), cameras)
        return [f.depth for f in frames if f.depth is not None]

    def frames(self, views: Sequence[RigView], cameras: Sequence[CameraSpec]) -> list[Frame]:
        """Returns the frames of cameras on the links of a batch of views."""
        padded = [*views, *[views[-1]] * (len(self.links) - len(views))]
        now = self._state([v.T_world_rig for v in padded], NS_PER_S)
        before = self._state([v.earlier(_SHUTTER_LEAD_S) for v in padded], round((1.0 - _SHUTTER_LEAD_S) * NS_PER_S))
        return self._renderer.render(now, cameras, before)

    def _state(self, T_world_links: Sequence[F64], stamp_ns: int) -> SceneState:
        poses = [pose_from_matrix(T) for T in T_world_links]
        return SceneState(
            stamp_ns, 0, self._revision, self.links, np.array([p.position for p in poses]),
            np.array([p.quat_xyzw for p in poses]), np.zeros((len(poses), 6)),
        )  # fmt: skip


def _plan(scene: SceneSpec, settings: ScanSettings, renderer: _RigRenderer, progress: Progress) -> ScanPlan:
    tour, camera, defects = settings.tour, settings.camera, settings.defects
    storeys = find_storeys(scene, tour)
    surface = sample_surface(*opaque_triangles(scene), SURFACE_POINTS, np.random.default_rng([tour.seed, 0]))
    max_views = (tour.frames // len(tour.pitches)) or _MAX_VIEWS
    views_per_station = min(max(round(360.0 / tour.turn_deg), 1), max_views)
    selected = select_stations(
        candidate_stations(storeys, tour), storeys, surface, camera, tour, (defects.range_min, defects.range_max),
        max(max_views // views_per_station, 1), renderer.depths, lambda fraction: progress(0.1 * fraction),
    )  # fmt: skip
    return ScanPlan(
        tuple(plan_views(selected.stations, storeys, tour, views_per_station, max_views)),
        len(selected.stations),
        selected.coverage,
    )


class _Capture:
    """Renders and writes the missing images of a scan."""

    def __init__(self, folder: Path, settings: ScanSettings, plan: ScanPlan, camera: _RigRenderer, shiny: frozenset[int]) -> None:
        self._folder, self._settings, self._plan, self._camera, self._shiny = folder, settings, plan, camera, shiny
        self._count = len(settings.tour.pitches)

    def run(self, progress: Progress) -> None:
        missing = [k for k in range(len(self._plan.views)) if not all(map(self._exists, self._image_numbers(k)))]
        for first in range(0, len(missing), _BATCH_SIZE):
            progress(0.1 + 0.9 * (1.0 - (len(missing) - first) / len(self._plan.views)))
            part = missing[first : first + _BATCH_SIZE]
            specs = [spec for link, view in zip(self._camera.links, part, strict=False) for spec in self._cameras(link, view)]
            numbers = [number for view in part for number in self._image_numbers(view)]
            frames = self._camera.frames([self._plan.views[k] for k in part], specs)
            for number, frame in zip(numbers, frames, strict=True):
                self._write(number, frame)

    def _image_numbers(self, view: int) -> range:
        return range(view * self._count, (view + 1) * self._count)

    def _exists(self, number: int) -> bool:
        return _depth_path(self._folder, number).is_file() and _color_path(self._folder, number).is_file()

    def _cameras(self, link: str, view: int) -> list[CameraSpec]:
        camera, seed = self._settings.camera, self._settings.tour.seed
        outputs: tuple[Output, ...] = ("rgb", "depth", "semantic") if self._shiny else ("rgb", "depth")
        return [
            CameraSpec(
                f"{number:06d}", link, pose_from_matrix(mount), camera.width, camera.height, math.radians(camera.fov_y_deg),
                near=0.03, outputs=outputs, samples=camera.samples, effects=image_effects(self._settings.defects, seed, view),
            )
            for number, mount in zip(self._image_numbers(view), mounts(self._settings.tour), strict=True)
        ]  # fmt: skip

    def _write(self, number: int, frame: Frame) -> None:
        defects, seed = self._settings.defects, self._settings.tour.seed
        shiny = np.isin(frame.semantic, list(self._shiny)) if frame.semantic is not None else None
        depth = measured_depth(frame, defects, shiny, seed, number)
        assert frame.rgb is not None
        quality = [cv2.IMWRITE_JPEG_QUALITY, defects.jpeg_quality]
        write_picture(_color_path(self._folder, number), frame.rgb[:, :, ::-1], quality, durable=False)
        write_picture(_depth_path(self._folder, number), depth_units(depth, DEPTH_SCALE), durable=False)


def mounts(tour: TourSettings) -> list[F64]:
    """Returns T_rig_camera of each camera, (4, 4), optical frame."""
    out = []
    for pitch in tour.pitches:
        T = matrix_from_pose(pose_from_xyz_rpy(rpy=(0.0, -math.radians(pitch), 0.0)))
        T[:3, :3] = T[:3, :3] @ R_LINK_OPTICAL
        out.append(T)
    return out


def _shiny_class_ids(classes: Sequence[str], defects: Defects) -> frozenset[int]:
    """Returns the ids of the semantic classes with shiny surfaces."""
    words = [word.strip() for word in defects.shiny_classes.split(",") if word.strip()]
    if not defects.shiny_fraction:
        return frozenset()
    return frozenset(k for k, name in enumerate(classes) if any(word in name.lower() for word in words))


def _resumed_plan(folder: Path, scene: SceneSpec, settings: ScanSettings) -> ScanPlan | None:
    """Returns the plan of an interrupted scan in a folder, or None for an empty or new folder.

    Raises:
        ScanError: the folder holds another scan, or something else.
    """
    path = folder / DESCRIPTION
    if not path.is_file():
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise ScanError(f"--output {folder}: already exists and is not a scan; give another name or remove it")
        return None
    description = read_json(path)
    expected = _description(scene, settings)
    different = [key for key in expected if not isinstance(description, dict) or description.get(key) != expected[key]]
    if different:
        raise ScanError(
            f"--output {folder}: holds another scan (it differs in {', '.join(different)}); give another name, or the same options to resume it"
        )
    try:
        return ScanPlan(
            tuple(RigView(*values) for values in description["views"]), description["stations"], description["coverage"]
        )
    except (KeyError, TypeError) as error:
        raise ScanError(f"{path}: is damaged ({error}); remove the folder and scan again") from error


def _write_headers(folder: Path, scene: SceneSpec, settings: ScanSettings, plan: ScanPlan) -> None:
    """Writes all files but the images, the description last, so that a folder with a description lacks images only."""
    for part in ("color", "depth"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    T_world_rigs = np.stack([v.T_world_rig for v in plan.views])
    T_rig_cameras = np.stack(mounts(settings.tour))
    stamps = np.repeat([v.stamp_s for v in plan.views], len(T_rig_cameras))
    true_poses = (T_world_rigs[:, None] @ T_rig_cameras[None]).reshape(-1, 4, 4)
    estimated = (estimated_poses(T_world_rigs, settings.defects, settings.tour.seed)[:, None] @ T_rig_cameras[None]).reshape(
        -1, 4, 4
    )
    # The cameras of a rig are synchronised, but readers of stamped poses need distinct stamps.
    stamps += np.tile(np.arange(len(T_rig_cameras)) * 1e-3, len(T_world_rigs))
    write_stamped_poses(folder / "true_poses.txt", stamps, true_poses)
    write_stamped_poses(folder / "poses.txt", stamps, estimated)
    write_trajectory_log(folder / "trajectory.log", estimated)
    write_intrinsics(folder / "intrinsic.json", intrinsics_of(settings.camera))
    description: dict[str, Any] = {
        **_description(scene, settings), "frames": len(true_poses), "stations": plan.stations, "coverage": plan.coverage,
        "views": [list(asdict(v).values()) for v in plan.views],
    }  # fmt: skip
    write_file(folder / DESCRIPTION, json.dumps(description, indent=1))


def intrinsics_of(camera: ScanCamera) -> Intrinsics:
    """Returns the intrinsics of the scanner's cameras."""
    K = CameraSpec("", "", width=camera.width, height=camera.height, fov_y=math.radians(camera.fov_y_deg)).intrinsics()
    return Intrinsics(camera.width, camera.height, K[0, 0], K[1, 1], K[0, 2], K[1, 2])


def _description(scene: SceneSpec, settings: ScanSettings) -> dict[str, Any]:
    return {
        "format": FORMAT, "version": 1, "made_by": f"gibson_sim {__version__}", "scene": scene.name,
        "content_hash": scene.content_hash, "depth_scale": DEPTH_SCALE, "settings": asdict(settings),
    }  # fmt: skip


def _color_path(folder: Path, number: int) -> Path:
    return folder / "color" / f"{number:06d}.jpg"


def _depth_path(folder: Path, number: int) -> Path:
    return folder / "depth" / f"{number:06d}.png"
