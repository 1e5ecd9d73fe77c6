"""Stages of an import from photographs: mesh, planes, levelling, texture, scene, collision, maps, check, held-out comparison."""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import EnvironmentProblemError, SceneError
from gibson_sim.filling.fillers import open_filler
from gibson_sim.formats.load_mesh import load_mesh
from gibson_sim.geometry.transforms import transform_points
from gibson_sim.maps.export import write_nav2_map, write_picture as write_map_picture
from gibson_sim.maps.floor_map import FloorMap, scene_floor_map
from gibson_sim.maps.scene_files import write_scene_files
from gibson_sim.maps.traversability import RobotSize
from gibson_sim.picture_files import write_picture
from gibson_sim.reading import read_file
from gibson_sim.scenes.load import load_scene
from gibson_sim.scenes.scene_yaml import DESCRIPTION
from gibson_sim.types import Vec3
from gibson_sim.writing import cannot_write, size_text, write_file
from gibson_sim_tools.from_photographs.closed_floor import closed_floor
from gibson_sim_tools.from_photographs.given_mesh import given_mesh
from gibson_sim_tools.from_photographs.image_checks import check_photographs
from gibson_sim_tools.from_photographs.inputs import PhotographInputs
from gibson_sim_tools.from_photographs.rerendering import FRONTS, HOLES, RenderPhotograph, contact_sheet, photograph_renderer
from gibson_sim_tools.from_photographs.settings import PhotographSettings
from gibson_sim_tools.from_photographs.stages import Progress, Stage, StagedJob, StageResult
from gibson_sim_tools.importing.checks.check import check_path
from gibson_sim_tools.importing.document import (
    ASSETS,
    BAKED_LIGHT,
    MIN_SCAN_TRIANGLES,
    SIMPLIFIED,
    ImportedObject,
    ImportedScene,
    write_scene,
)
from gibson_sim_tools.importing.glb import write_glb
from gibson_sim_tools.scanning.fusion import fuse_scan, open3d, simplify_quadric
from gibson_sim_tools.scanning.planes import snap_to_planes
from gibson_sim_tools.scanning.pose_conventions import detect_convention, reinterpret_poses
from gibson_sim_tools.scanning.posed_images import Photographs, ScanError
from gibson_sim_tools.scanning.settings import AS_READ, AUTO, FuseSettings
from gibson_sim_tools.scanning.triangle_mesh import TriangleMesh, decimated, level_transform, level_transform_from_up, write_ply
from gibson_sim_tools.texturing.conventions import resolve_convention
from gibson_sim_tools.texturing.evaluation import ImageSimilarity, RenderedImage, image_similarity
from gibson_sim_tools.texturing.photograph_selection import select_photographs
from gibson_sim_tools.texturing.settings import MOST_PHOTOGRAPHS, POSE_CONVENTIONS, TextureSettings
from gibson_sim_tools.texturing.surface import check_split, surface_from_mesh
from gibson_sim_tools.texturing.texture import texture_surface
from gibson_sim_tools.texturing.textured_scene import textured_mesh

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

INTERMEDIATES = "import"
"""Folder of intermediate files, in the folder of the scene."""
SHEET = "photographs.jpg"
UNSEEN_FLOOR = "unseen_floor"
"""Name of the object that fills unobserved floor."""
MAP_ROBOT = RobotSize(radius=0.2, height=0.5)
"""Robot size of the maps and free poses, metres: that of ``scene check``."""
_FUSED, _MESH, _TEXTURED = f"{INTERMEDIATES}/fused.ply", f"{INTERMEDIATES}/mesh.ply", f"{INTERMEDIATES}/textured.glb"
_RECORDS = {name: f"{INTERMEDIATES}/{name}.json" for name in ("fused", "level", "texture", "check", "likeness")}
_LEVEL_TOLERANCE_DEG, _FLOOR_TOLERANCE = 0.1, 0.02
"""Tilt within which a scan is not rotated, degrees, and floor height within which it is not translated either, metres."""
_UP: dict[str, Vec3] = {"polycam": (0.0, 1.0, 0.0), "record3d": (0.0, 1.0, 0.0)}
"""Approximate up direction in the world frame of layouts that are aligned with gravity: the roll of a phone says nothing about it."""
_VOXEL_RANGE = (0.005, 0.05)
"""Range of the voxel size that is assumed for a supplied mesh from its edge lengths, metres."""
_MAX_BYTES = 256 * 2**20


@dataclass(frozen=True, slots=True, eq=False)
class PhotographImport:
    """An import from photographs, as a job of resumable stages."""

    inputs: PhotographInputs
    output: Path
    """Folder of the scene."""
    settings: PhotographSettings
    name: str
    """Name of the scene."""
    up: Vec3 | None = None
    """Approximate up direction in the frame of the poses, (3,); None = that of the layout, or of the cameras."""
    unit_m: float | None = None
    """Metres per unit of the poses and the mesh; None = metres."""
    pose_convention: str = AUTO
    """Convention of the poses: one of ``POSE_CONVENTIONS``, ``as-read`` or ``auto``."""
    source: str = ""
    """Source of the job, see ``StagedJob``; empty = the folder of the photographs."""

    def stages(self) -> list[Stage]:
        """Returns all stages in their order."""
        s, inputs = self.settings, self.inputs
        count = len(inputs.photographs)
        mesh = (
            Stage(
                "fuse",
                self._fuse,
                (_FUSED, _RECORDS["fused"]),
                (s.voxel, s.depth_max, s.hold_out, s.hold_out_depth, self.pose_convention),
                0.08 * count,
            )
            if inputs.mesh is None
            else Stage(
                "mesh", self._load_mesh, (_FUSED, _RECORDS["fused"]), (_file_state(inputs.mesh), self.pose_convention), 10.0
            )
        )
        return [
            Stage("photographs", self._check_images, (), self._inputs(), 0.02 * count),
            mesh,
            Stage("planes", self._planes, (_MESH,), (s.snap, s.triangles), 8.0),
            Stage("level", self._level, (_RECORDS["level"],), self.up, 2.0),
            Stage("texture", self._texture, (_TEXTURED, _RECORDS["texture"]), (s.hold_out, s.longest_side), 20.0 + 0.4 * count),
            Stage("scene", self._scene, (DESCRIPTION, ASSETS), (self.name, s.close_floor), 3.0),
            Stage("collision", self._collision, (), None, 15.0),
            Stage("floor map", self._write_maps, ("maps/floor_0.yaml",), None, 3.0),
            Stage("check", self._check_scene, (_RECORDS["check"],), None, 15.0),
            *([Stage("compare", self._compare, (SHEET, _RECORDS["likeness"]), s.fill, 10.0)] if s.hold_out else []),
        ]

    def run(
        self, stage_progress: Callable[[int], AbstractContextManager[Progress]], on_result: Callable[[StageResult], None]
    ) -> None:
        """Runs the stages that are not completed; see ``StagedJob.run`` for the arguments.

        Raises:
            GibsonSimError: a stage failed; the next run resumes there.
        """
        if self.inputs.mesh is None:
            open3d()  # before any work
        if self.settings.fill:
            open_filler(self.settings.fill)  # likewise: a missing network
        job = StagedJob(self.output, self.source or str(self.inputs.photographs.folder.resolve()))
        with job.locked():
            job.run(self.stages(), stage_progress, on_result)

    def _inputs(self) -> Any:
        """Returns the options of the first stage: state of the image files, poses, camera models, scales."""
        photographs = self.inputs.photographs
        cameras = [(item.camera.intrinsics, item.camera.distortion, item.camera.fisheye) for item in photographs.items]
        files = [_file_state(file) for file in self._files()]
        return files, photographs.poses, cameras, [item.depth_scale for item in photographs.items], self.unit_m

    def _files(self) -> list[Path]:
        items = self.inputs.photographs.items
        return [item.file for item in items] + [item.depth for item in items if item.depth is not None]

    def _held_out(self) -> I64:
        """Returns the numbers of the held-out photographs."""
        every = self.settings.hold_out
        return np.arange(0, len(self.inputs.photographs), every) if every else np.zeros(0, dtype=np.int64)

    def _check_images(self, progress: Progress) -> Sequence[str]:
        rgbd = self.inputs.rgbd
        depth_size = (rgbd.intrinsics.width, rgbd.intrinsics.height) if rgbd is not None and rgbd.is_registered else None
        total = check_photographs(self.inputs.photographs, progress, depth_size)
        return [f"{len(self._files())} images are whole, {size_text(total)}"]

    def _fuse(self, progress: Progress) -> Sequence[str]:
        assert self.inputs.rgbd is not None
        settings = FuseSettings(voxel=self.settings.voxel, depth_max=self.settings.depth_max, snap=0.0)
        photographs, rgbd = self.inputs.photographs, self.inputs.rgbd
        held_out_files = {photographs.items[k].file for k in self._held_out()}
        held_out = [k for k, item in enumerate(rgbd.photographs.items) if item.file in held_out_files]
        if self.settings.hold_out_depth:
            rgbd, held_out = rgbd.subset(np.setdiff1d(np.arange(len(rgbd)), held_out).tolist()), []
        convention, message = detect_convention(rgbd, range(len(rgbd)), settings.depth_max, self.pose_convention)
        fusion = fuse_scan(
            rgbd.with_poses(reinterpret_poses(rgbd.poses, rgbd.layout, convention)), settings, progress, depth_only=held_out
        )
        write_ply(self.output / _FUSED, fusion.mesh)
        poses = reinterpret_poses(photographs.poses, photographs.layout, convention)
        self._write("fused", {"voxel": fusion.voxel, "coloured": True, "T_scan_camera": poses.tolist()})
        lines = [f"{len(fusion.mesh.triangles)} triangles, {fusion.mesh.area:.1f} m^2, from {len(rgbd)} depth images"]
        if held_out:
            lines[0] += f", {len(held_out)} of them without their colours"
        return [
            *([message] if message else []),
            *lines,
            *([] if fusion.selected is None else [fusion.selected.text(settings.memory)]),
        ]

    def _load_mesh(self, progress: Progress) -> Sequence[str]:
        assert self.inputs.mesh is not None
        photographs = self.inputs.photographs
        given = given_mesh(self.inputs.mesh, photographs, self.pose_convention, progress)
        mesh = given.mesh.scaled(float(np.float32(self.unit_m or 1.0))).single()
        convention, message = self.pose_convention, ""
        if convention == AUTO and given.convention != AS_READ:
            convention = given.convention
            message = f"poses are read as {convention}: {POSE_CONVENTIONS[convention]} (as read, no photograph shows the mesh)"
        posed, found = resolve_convention(mesh, photographs.scaled(self.unit_m or 1.0), convention)
        check_split(mesh, TextureSettings().longest_edge)
        corners = mesh.corners[:: max(len(mesh.triangles) // 100_000, 1)].astype(np.float32)
        edge = float(np.median(np.linalg.norm(corners[:, 0] - corners[:, 1], axis=1)))
        write_ply(self.output / _FUSED, mesh)
        voxel = min(max(edge, _VOXEL_RANGE[0]), _VOXEL_RANGE[1])
        self._write("fused", {"voxel": voxel, "coloured": given.has_colors, "T_scan_camera": posed.poses.tolist()})
        return [given.text, *(line for line in (message, found) if line)]

    def _planes(self, progress: Progress) -> Sequence[str]:
        mesh, lines = self._read_mesh(_FUSED), []
        if self.settings.snap:
            mesh, report = snap_to_planes(mesh, float(self._read("fused")["voxel"]), self.settings.snap)
            lines.append(report.text() if report.planes else "no large plane whose noise could be removed")
        progress(0.5)
        most, count = self.settings.triangles, len(mesh.triangles)
        if most and count > most:
            mesh = _simplify(mesh, most)
            lines.append(f"simplified from {count} to {len(mesh.triangles)} triangles")
        write_ply(self.output / _MESH, mesh)
        return lines or ["nothing to change"]

    def _level(self, progress: Progress) -> Sequence[str]:
        mesh = self._read_mesh(_MESH)
        up = self.up or _UP.get(self.inputs.photographs.layout)
        try:
            poses = np.array(self._read("fused")["T_scan_camera"])
            T = level_transform(mesh, poses) if up is None else level_transform_from_up(mesh, np.asarray(up))
        except ScanError as error:
            raise ScanError(
                "the mesh has no floor: no level surface of it faces up, if the cameras are roughly upright; say with --up-axis "
                "which way is up in the frame of the poses (y, -z, 0.1,0.3,0.9), or photograph the floor, too"
            ) from error
        tilt, floor = math.degrees(math.acos(min(1.0, float(T[2, 2])))), -float(T[2, 3])
        if tilt <= _LEVEL_TOLERANCE_DEG:
            # A tilt within the noise of the measurement is not corrected.
            T = np.eye(4)
            T[2, 3] = 0.0 if abs(floor) <= _FLOOR_TOLERANCE else -floor
        self._write(
            "level", {"T_level_scan": T.tolist(), "floor_z": floor + float(T[2, 3]) if tilt <= _LEVEL_TOLERANCE_DEG else 0.0}
        )
        return [
            f"the floor is level to {tilt:.2f} degrees, at z = {floor + 0.0:.3f} m"
            if tilt <= _LEVEL_TOLERANCE_DEG
            else f"turned by {tilt:.2f} degrees: z is up and the floor is at z = 0"
        ]

    def _texture(self, progress: Progress) -> Sequence[str]:
        T = self._T_level_scan()
        mesh = self._read_mesh(_MESH)
        colors = mesh.colors if self._read("fused")["coloured"] else None
        surface = replace(mesh, vertices=transform_points(T, mesh.vertices), colors=colors)
        photographs = self._level_photographs(T)
        numbers, held_out = self._select_photographs(surface, photographs, lambda part: progress(0.1 * part))
        photographs = photographs.subset(numbers)
        settings = TextureSettings(longest_side=self.settings.longest_side)
        textured = texture_surface(surface, photographs, settings, lambda part: progress(0.1 + 0.9 * part), held_out=held_out)
        (self.output / INTERMEDIATES).mkdir(exist_ok=True)
        write_glb(self.output / _TEXTURED, textured_mesh(textured))
        poses = textured.photographs.poses.tolist()
        record = {"numbers": numbers.tolist(), "held_out": held_out, "T_world_camera": poses}
        self._write("texture", {**textured.report.as_dict(), **record})
        fewer = len(numbers) < len(self.inputs.photographs)
        return [
            *([f"{len(numbers)} of {len(self.inputs.photographs)} photographs are used"] if fewer else []),
            *(
                [f"{_photographs(len(held_out))} {'is' if len(held_out) == 1 else 'are'} held out ({self._unused_data()})"]
                if held_out
                else []
            ),
            *textured.report.lines(),
        ]

    def _unused_data(self) -> str:
        """Returns the data of the held-out photographs that is not used, as text."""
        return "colours and depth" if self.settings.hold_out_depth else "colours"

    def _select_photographs(self, surface: TriangleMesh, photographs: Photographs, progress: Progress) -> tuple[I64, list[int]]:
        """Returns the numbers of the selected and held-out photographs, ascending, and the indices of the held-out ones in that array."""
        held_out = self._held_out()
        others = np.setdiff1d(np.arange(len(photographs)), held_out)
        if self.settings.hold_out and len(photographs) > MOST_PHOTOGRAPHS:
            count = min(len(held_out), max(MOST_PHOTOGRAPHS // self.settings.hold_out, 1))
            held_out = held_out[np.linspace(0, len(held_out) - 1, count).round().astype(int)]
        selected = select_photographs(surface, photographs.subset(others), MOST_PHOTOGRAPHS - len(held_out), progress)
        numbers = np.sort(np.concatenate([others[selected], held_out]))
        return numbers, np.flatnonzero(np.isin(numbers, held_out)).tolist()

    def _scene(self, progress: Progress) -> Sequence[str]:
        textured = self.output / _TEXTURED
        mesh = load_mesh(textured, [textured.parent])
        vertices, triangles = mesh.merged()
        collision = SIMPLIFIED if len(triangles) >= MIN_SCAN_TRIANGLES else "same"
        scene = ImportedScene(self.name, "folder of photographs", (self.output / INTERMEDIATES).resolve(), light=BAKED_LIGHT)
        scene.objects = [ImportedObject(self.name, textured, collision=collision)]
        # The floor of a level scan may differ from z = 0 within the tolerance.
        floor_z = float(self._read("level")["floor_z"])
        scene.floors = (round(floor_z, 4) + 0.0,)
        lines = []
        eyes = self._level_photographs(self._T_level_scan()).poses[:, :3, 3]
        boards = closed_floor(vertices, triangles, eyes, floor_z) if self.settings.close_floor else None
        if boards is not None:
            scene.objects.append(ImportedObject(UNSEEN_FLOOR, boards.mesh, semantic_class="floor"))
            lines.append(
                f"{boards.area:.1f} m^2 of unobserved floor are filled with grey boards (object {UNSEEN_FLOOR}); --no-close-floor "
                "leaves it open"
            )
        progress(0.5)
        _replace_scene(scene, self.output)
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        size = " x ".join(f"{c:.1f}" for c in (high - low).tolist())
        return [f"{self.output / DESCRIPTION}: {len(triangles)} triangles, {size} m", *lines]

    def _collision(self, progress: Progress) -> Sequence[str]:
        scene = load_scene(self.output)
        return [
            f"{len(scene.collisions)} shapes; floors at {', '.join(f'{round(z, 2) + 0.0:.2f}' for z in scene.floors)} m",
            *scene.warnings,
        ]

    def _write_maps(self, progress: Progress) -> Sequence[str]:
        scene = load_scene(self.output)
        lines = []
        for number, floor_z in enumerate(scene.floors):
            floor = scene_floor_map(replace(scene, floor_z=floor_z), robot_height=MAP_ROBOT.height)
            write_nav2_map(floor, self.output / "maps" / f"floor_{number}")
            write_map_picture(floor, self.output / "maps" / f"floor_{number}.png", MAP_ROBOT.radius)
            lines.append(_describe_map(floor, number, len(scene.floors)))
            progress((number + 1) / (len(scene.floors) + 1))
        try:
            write_scene_files(self.output, MAP_ROBOT)
        except SceneError as error:
            lines.append(f"no free poses: {error}")
        return lines

    def _check_scene(self, progress: Progress) -> Sequence[str]:
        report = check_path(self.output)
        self._write("check", report.json())
        findings = [f for f in report.findings if f.level != "note"]
        holes = next((f for f in report.findings if f.what == "view-holes"), None)
        lines = [f"{f.level}: {f.what}: {f.text}" for f in findings if f is not holes]
        lines.append(
            f"{holes.text}"
            if holes is not None
            else "no holes in a robot's views"
            if report.free_floor
            else "no position is free for a robot"
        )
        return lines

    def _compare(self, progress: Progress) -> Sequence[str]:
        record = self._read("texture")
        photographs = self.inputs.photographs.subset(record["numbers"]).with_poses(np.array(record["T_world_camera"]))
        numbers, rendered = record["held_out"], 0
        pixels = sum(photographs.intrinsics(k).width * photographs.intrinsics(k).height for k in numbers)
        with photograph_renderer(load_scene(self.output), photographs, UNSEEN_FLOOR) as render:

            def render_with_progress(number: int) -> RenderedImage:
                nonlocal rendered
                rendered += 1
                progress((0.5 if self.settings.fill else 0.9) * rendered / len(numbers))
                return render(number)

            similarity = image_similarity(photographs, render_with_progress, numbers=numbers)
            filled = self._compare_filled(photographs, numbers, render) if self.settings.fill else {}
            sheet = contact_sheet(photographs, render, numbers, self._unused_data())
        share = similarity.pixels / pixels
        write_picture(self.output / SHEET, sheet[:, :, ::-1])
        self._write(
            "likeness",
            {
                "psnr": similarity.psnr,
                "ssim": similarity.ssim,
                "seen": share,
                "photographs": len(numbers),
                "filled": {region: [asdict(one) for one in both] for region, both in filled.items()},
            },
        )
        count = f"{len(numbers)} held-out photograph{'' if len(numbers) == 1 else 's'}"
        lines = [
            f"{count} ({self._unused_data()}), re-rendered: PSNR {similarity.psnr:.1f} dB, SSIM {similarity.ssim:.2f}, "
            f"where the scene has a surface ({100.0 * share:.0f} % of their pixels); --hold-out 0 uses them, too"
        ]
        for region, (before, after) in filled.items():
            what = "front faces" if region == FRONTS else "holes"
            lines.append(
                f"{what} ({100.0 * before.pixels / pixels:.1f} % of the pixels), as rendered and filled by {self.settings.fill}: PSNR "
                f"{before.psnr:.2f} and {after.psnr:.2f} dB, SSIM {before.ssim:.3f} and {after.ssim:.3f}"
                if before.pixels
                else f"{what}: none in these photographs"
            )
        return [*lines, *([similarity.warning()] if similarity.warning() else [])]

    def _compare_filled(
        self, photographs: Photographs, numbers: Sequence[int], render: RenderPhotograph
    ) -> dict[str, tuple[ImageSimilarity, ImageSimilarity]]:
        """Returns region -> similarity metrics of the images as rendered, and with filled holes."""

        def similarity(fill: str, region: str) -> ImageSimilarity:
            return image_similarity(photographs, lambda number: render(number, fill, region), numbers=numbers)

        return {region: (similarity("", region), similarity(self.settings.fill, region)) for region in (FRONTS, HOLES)}

    def _T_level_scan(self) -> F64:
        return np.array(self._read("level")["T_level_scan"])

    def _level_photographs(self, T_level_scan: F64) -> Photographs:
        return self.inputs.photographs.with_poses(T_level_scan @ np.array(self._read("fused")["T_scan_camera"]))

    def _read_mesh(self, name: str) -> TriangleMesh:
        path = self.output / name
        return surface_from_mesh(load_mesh(path, [path.parent]))

    def _read(self, name: str) -> Any:
        return json.loads(read_file(self.output / _RECORDS[name], _MAX_BYTES))

    def _write(self, name: str, values: Any) -> None:
        write_file(self.output / _RECORDS[name], json.dumps(values))


def _photographs(count: int) -> str:
    return f"{count} photograph{'' if count == 1 else 's'}"


def _file_state(path: Path) -> tuple[str, int, int]:
    """Returns path, size (bytes) and modification time (ns) of a file; -1 if it is missing, which its reader reports."""
    try:
        status = path.stat()
    except OSError:
        return str(path), -1, -1
    return str(path), status.st_size, status.st_mtime_ns


def _simplify(mesh: TriangleMesh, triangles: int) -> TriangleMesh:
    try:
        return simplify_quadric(mesh, triangles)
    except EnvironmentProblemError:
        # An import of a supplied mesh works without Open3D.
        return decimated(mesh, triangles)


def _replace_scene(scene: ImportedScene, output: Path) -> None:
    """Writes a scene into a folder and keeps the other files of the folder."""
    fresh = output / INTERMEDIATES / "scene"
    shutil.rmtree(fresh, ignore_errors=True)
    write_scene(scene, fresh)
    try:
        shutil.rmtree(output / ASSETS, ignore_errors=True)
        (fresh / ASSETS).rename(output / ASSETS)
        (fresh / DESCRIPTION).replace(output / DESCRIPTION)
        shutil.rmtree(fresh)
    except OSError as error:
        raise cannot_write(output, error) from error


def _describe_map(floor: FloorMap, number: int, count: int) -> str:
    cell = floor.resolution**2
    region = float(floor.largest_free_region(MAP_ROBOT.radius).sum()) * cell
    where = f"floor {number}: " if count > 1 else ""
    return f"{where}{float(floor.free.sum()) * cell:.1f} m^2 free, {region:.1f} m^2 of them for a robot of radius {MAP_ROBOT.radius:g} m"
