"""All stages from a folder of photographs to a scene that robots drive in."""

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
from gibson_sim.scenes.load import DESCRIPTION, load_scene
from gibson_sim.types import Vec3
from gibson_sim.writing import cannot_write, size_text, write_file
from gibson_sim_tools.from_photographs.closed_floor import closed_floor
from gibson_sim_tools.from_photographs.found import Found
from gibson_sim_tools.from_photographs.given_mesh import given_mesh
from gibson_sim_tools.from_photographs.pictures import check_pictures
from gibson_sim_tools.from_photographs.settings import PhotographSettings
from gibson_sim_tools.from_photographs.sheet import FRONTS, HOLES, DrawPhotograph, contact_sheet, photograph_renderer
from gibson_sim_tools.from_photographs.work import Ended, Progress, Stage, Work
from gibson_sim_tools.importing.checks.check import check_path
from gibson_sim_tools.importing.document import ASSETS, BAKED_LIGHT, SIMPLIFIED, ImportedObject, ImportedScene, write_scene
from gibson_sim_tools.importing.glb import write_glb
from gibson_sim_tools.importing.scans import SCAN_FROM
from gibson_sim_tools.photographs.photographs import Photographs
from gibson_sim_tools.scanning.coloured_mesh import ColouredMesh, level_transform, level_transform_near, thinned, write_ply
from gibson_sim_tools.scanning.fusion import fuse_scan, open3d, simplified
from gibson_sim_tools.scanning.planes import snapped
from gibson_sim_tools.scanning.pose_conventions import agreeing_convention, reread
from gibson_sim_tools.scanning.posed_rgbd import ScanError
from gibson_sim_tools.scanning.settings import AUTO, FuseSettings
from gibson_sim_tools.texturing.conventions import resolve_convention
from gibson_sim_tools.texturing.evaluation import ImageSimilarity, RenderedImage, image_similarity
from gibson_sim_tools.texturing.photograph_selection import select_photographs
from gibson_sim_tools.texturing.settings import MOST_PHOTOGRAPHS, TextureSettings
from gibson_sim_tools.texturing.surface import Surface, surface_from_mesh
from gibson_sim_tools.texturing.texture import texture_surface
from gibson_sim_tools.texturing.textured_scene import textured_mesh

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

WORK = "import"
"""Folder of what the stages leave for each other, in that of the scene."""
SHEET = "photographs.jpg"
UNSEEN_FLOOR = "unseen_floor"
"""Name of the boards that close the floor."""
MAP_ROBOT = RobotSize(radius=0.2, height=0.5)
"""Robot that the maps and free poses are made for: that of ``scene check``."""
_FUSED, _MESH, _TEXTURED = f"{WORK}/fused.ply", f"{WORK}/mesh.ply", f"{WORK}/textured.glb"
_FACTS = {name: f"{WORK}/{name}.json" for name in ("fused", "level", "texture", "check", "likeness")}
_LEVEL_DEG, _AT_FLOOR = 0.1, 0.02
"""A scan that is level within this, degrees, is not turned, and not moved if its floor is so near to z = 0, metres."""
_UP: dict[str, Vec3] = {"polycam": (0.0, 1.0, 0.0), "record3d": (0.0, 1.0, 0.0)}
"""Rough direction of up in the frame of layouts that know gravity; phones are held any way."""
_EDGES = (0.005, 0.05)
"""Range of the edges of triangles, metres, that count as voxels of a mesh that was given."""
_MOST_BYTES = 256 * 2**20


@dataclass(frozen=True, slots=True, eq=False)
class Import:
    """An import from photographs."""

    found: Found
    output: Path
    """Folder of the scene."""
    settings: PhotographSettings
    name: str
    """Name of the scene."""
    up: Vec3 | None = None
    """Rough direction of up in the frame of the poses; None = that of the cameras."""
    unit_m: float | None = None
    """Metres per unit of the poses and the mesh; None = metres."""
    source: str = ""
    """What the scene is made from; empty = the folder of the photographs."""

    def stages(self) -> list[Stage]:
        """Returns all stages in their order."""
        s, found = self.settings, self.found
        count = len(found.photographs)
        mesh = (
            Stage(
                "fuse", self._fuse, (_FUSED, _FACTS["fused"]), (s.voxel, s.depth_max, s.hold_out, s.hold_out_depth), 0.08 * count
            )
            if found.mesh is None
            else Stage("mesh", self._given, (_FUSED, _FACTS["fused"]), _state(found.mesh), 10.0)
        )
        return [
            Stage("photographs", self._check, (), self._inputs(), 0.02 * count),
            mesh,
            Stage("planes", self._planes, (_MESH,), (s.snap, s.triangles), 8.0),
            Stage("level", self._level, (_FACTS["level"],), self.up, 2.0),
            Stage("texture", self._texture, (_TEXTURED, _FACTS["texture"]), (s.hold_out, s.longest_side), 20.0 + 0.4 * count),
            Stage("scene", self._scene, (DESCRIPTION, ASSETS), (self.name, s.close_floor), 3.0),
            Stage("collision", self._collision, (), None, 15.0),
            Stage("floor map", self._map, ("maps/floor_0.yaml",), None, 3.0),
            Stage("check", self._check_scene, (_FACTS["check"],), None, 15.0),
            *([Stage("compare", self._compare, (SHEET, _FACTS["likeness"]), s.fill, 10.0)] if s.hold_out else []),
        ]

    def run(self, bar: Callable[[int], AbstractContextManager[Progress]], say: Callable[[Ended], None]) -> None:
        """Makes the scene, or what is missing of it.

        Raises:
            GibsonSimError: a stage failed; the next run goes on there.
        """
        if self.found.mesh is None:
            open3d()  # before any work
        if self.settings.fill:
            open_filler(self.settings.fill)  # likewise: a missing network
        work = Work(self.output, self.source or str(self.found.photographs.folder.resolve()))
        with work.alone():
            work.run(self.stages(), bar, say)

    def _inputs(self) -> Any:
        """Returns what tells whether the photographs changed."""
        photographs = self.found.photographs
        cameras = [(item.camera.intrinsics, item.camera.distortion, item.camera.fisheye) for item in photographs.items]
        files = [_state(file) for file in self._files()]
        return files, photographs.poses, cameras, [item.depth_scale for item in photographs.items], self.unit_m

    def _files(self) -> list[Path]:
        items = self.found.photographs.items
        return [item.file for item in items] + [item.depth for item in items if item.depth is not None]

    def _aside(self) -> I64:
        """Returns the numbers of the photographs that are kept aside."""
        every = self.settings.hold_out
        return np.arange(0, len(self.found.photographs), every) if every else np.zeros(0, dtype=np.int64)

    def _check(self, progress: Progress) -> Sequence[str]:
        files = self._files()
        total = check_pictures(files, progress)
        return [f"{len(files)} images are whole, {size_text(total)}"]

    def _fuse(self, progress: Progress) -> Sequence[str]:
        assert self.found.rgbd is not None
        settings = FuseSettings(voxel=self.settings.voxel, depth_max=self.settings.depth_max, snap=0.0)
        photographs, rgbd = self.found.photographs, self.found.rgbd
        files_aside = {photographs.items[k].file for k in self._aside()}
        aside = [k for k, files in enumerate(rgbd.files) if files.color in files_aside]
        if self.settings.hold_out_depth:
            rgbd, aside = rgbd.subset(np.setdiff1d(np.arange(len(rgbd)), aside).tolist()), []
        convention, said = agreeing_convention(rgbd, range(len(rgbd)), settings.depth_max, AUTO)
        fusion = fuse_scan(rgbd.with_poses(reread(rgbd.poses, rgbd.layout, convention)), settings, progress, depth_only=aside)
        write_ply(self.output / _FUSED, fusion.mesh)
        poses = reread(photographs.poses, photographs.layout, convention)
        self._write("fused", {"voxel": fusion.voxel, "coloured": True, "T_scan_camera": poses.tolist()})
        lines = [f"{len(fusion.mesh.triangles)} triangles, {fusion.mesh.area:.1f} m^2, from {len(rgbd)} depth images"]
        if aside:
            lines[0] += f", {len(aside)} of them without their colours"
        return [*([said] if said else []), *lines, *([] if fusion.selected is None else [fusion.selected.text(settings.memory)])]

    def _given(self, progress: Progress) -> Sequence[str]:
        assert self.found.mesh is not None
        mesh, coloured, text = given_mesh(self.found.mesh, self.found.photographs, progress)
        mesh = replace(mesh, vertices=mesh.vertices * np.float32(self.unit_m or 1.0))
        surface = Surface(mesh.vertices.astype(np.float64), mesh.triangles.astype(np.int64))
        posed, said = resolve_convention(surface, self.found.photographs.scaled(self.unit_m or 1.0), AUTO)
        corners = mesh.vertices[mesh.triangles[:: max(len(mesh.triangles) // 100_000, 1)]]
        edge = float(np.median(np.linalg.norm(corners[:, 0] - corners[:, 1], axis=1)))
        write_ply(self.output / _FUSED, mesh)
        voxel = min(max(edge, _EDGES[0]), _EDGES[1])
        self._write("fused", {"voxel": voxel, "coloured": coloured, "T_scan_camera": posed.poses.tolist()})
        return [text, said] if said else [text]

    def _planes(self, progress: Progress) -> Sequence[str]:
        mesh, lines = self._read_mesh(_FUSED), []
        if self.settings.snap:
            mesh, report = snapped(mesh, float(self._read("fused")["voxel"]), self.settings.snap)
            lines.append(report.text() if report.planes else "no large plane whose noise could be removed")
        progress(0.5)
        most, count = self.settings.triangles, len(mesh.triangles)
        if most and count > most:
            mesh = _simplified(mesh, most)
            lines.append(f"simplified from {count} to {len(mesh.triangles)} triangles")
        write_ply(self.output / _MESH, mesh)
        return lines or ["nothing to change"]

    def _level(self, progress: Progress) -> Sequence[str]:
        mesh = self._read_mesh(_MESH)
        up = self.up or _UP.get(self.found.photographs.layout)
        try:
            poses = np.array(self._read("fused")["T_scan_camera"])
            T = level_transform(mesh, poses) if up is None else level_transform_near(mesh, np.asarray(up))
        except ScanError as error:
            raise ScanError(
                "the mesh has no floor: no level surface of it faces up, if the cameras are roughly upright; say with --up-axis "
                "which way is up in the frame of the poses (y, -z, 0.1,0.3,0.9), or photograph the floor, too"
            ) from error
        tilt, floor = math.degrees(math.acos(min(1.0, float(T[2, 2])))), -float(T[2, 3])
        if tilt <= _LEVEL_DEG:
            # The noise of measuring is no reason to turn a scan that is level.
            T = np.eye(4)
            T[2, 3] = 0.0 if abs(floor) <= _AT_FLOOR else -floor
        self._write("level", {"T_level_scan": T.tolist(), "floor_z": floor + float(T[2, 3]) if tilt <= _LEVEL_DEG else 0.0})
        return [
            f"the floor is level to {tilt:.2f} degrees, at z = {floor + 0.0:.3f} m"
            if tilt <= _LEVEL_DEG
            else f"turned by {tilt:.2f} degrees: z is up and the floor is at z = 0"
        ]

    def _texture(self, progress: Progress) -> Sequence[str]:
        T = self._T_level_scan()
        mesh = self._read_mesh(_MESH)
        colors = mesh.colors if self._read("fused")["coloured"] else None
        surface = Surface(transform_points(T, mesh.vertices), mesh.triangles.astype(np.int64), colors)
        photographs = self._level_photographs(T)
        numbers, held_out = self._used(surface, photographs, lambda part: progress(0.1 * part))
        photographs = photographs.subset(numbers)
        settings = TextureSettings(longest_side=self.settings.longest_side)
        textured = texture_surface(surface, photographs, settings, lambda part: progress(0.1 + 0.9 * part), held_out=held_out)
        (self.output / WORK).mkdir(exist_ok=True)
        write_glb(self.output / _TEXTURED, textured_mesh(textured))
        poses = textured.photographs.poses.tolist()
        facts = {"numbers": numbers.tolist(), "held_out": held_out, "T_world_camera": poses}
        self._write("texture", {**textured.report.as_dict(), **facts})
        fewer = len(numbers) < len(self.found.photographs)
        return [
            *([f"{len(numbers)} of {len(self.found.photographs)} photographs are used"] if fewer else []),
            *([f"{len(held_out)} photographs are held out ({self._unused()})"] if held_out else []),
            *textured.report.lines(),
        ]

    def _unused(self) -> str:
        """Returns what of the photographs that are kept aside is not used."""
        return "colours and depth" if self.settings.hold_out_depth else "colours"

    def _used(self, surface: Surface, photographs: Photographs, progress: Progress) -> tuple[I64, list[int]]:
        """Returns the numbers of the photographs that are textured from or kept aside, and which of these are kept aside."""
        aside = self._aside()
        others = np.setdiff1d(np.arange(len(photographs)), aside)
        if self.settings.hold_out and len(photographs) > MOST_PHOTOGRAPHS:
            few = min(len(aside), max(MOST_PHOTOGRAPHS // self.settings.hold_out, 1))
            aside = aside[np.linspace(0, len(aside) - 1, few).round().astype(int)]
        chosen = select_photographs(surface, photographs.subset(others), MOST_PHOTOGRAPHS - len(aside), progress)
        numbers = np.sort(np.concatenate([others[chosen], aside]))
        return numbers, np.flatnonzero(np.isin(numbers, aside)).tolist()

    def _scene(self, progress: Progress) -> Sequence[str]:
        textured = self.output / _TEXTURED
        mesh = load_mesh(textured, [textured.parent])
        vertices, triangles = mesh.merged()
        collision = SIMPLIFIED if len(triangles) >= SCAN_FROM else "same"
        scene = ImportedScene(self.name, "folder of photographs", (self.output / WORK).resolve(), light=BAKED_LIGHT)
        scene.objects = [ImportedObject(self.name, textured, collision=collision)]
        # A scan that is level may keep its floor a little off z = 0.
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
        _replaced(scene, self.output)
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        size = " x ".join(f"{c:.1f}" for c in (high - low).tolist())
        return [f"{self.output / DESCRIPTION}: {len(triangles)} triangles, {size} m", *lines]

    def _collision(self, progress: Progress) -> Sequence[str]:
        scene = load_scene(self.output)
        return [
            f"{len(scene.collisions)} shapes; floors at {', '.join(f'{round(z, 2) + 0.0:.2f}' for z in scene.floors)} m",
            *scene.warnings,
        ]

    def _map(self, progress: Progress) -> Sequence[str]:
        scene = load_scene(self.output)
        lines = []
        for number, floor_z in enumerate(scene.floors):
            floor = scene_floor_map(replace(scene, floor_z=floor_z), robot_height=MAP_ROBOT.height)
            write_nav2_map(floor, self.output / "maps" / f"floor_{number}")
            write_map_picture(floor, self.output / "maps" / f"floor_{number}.png", MAP_ROBOT.radius)
            lines.append(_map_text(floor, number, len(scene.floors)))
            progress((number + 1) / (len(scene.floors) + 1))
        try:
            write_scene_files(self.output, MAP_ROBOT)
        except SceneError as error:
            lines.append(f"no free poses: {error}")
        return lines

    def _check_scene(self, progress: Progress) -> Sequence[str]:
        report = check_path(self.output)
        self._write("check", report.json())
        found = [f for f in report.findings if f.level != "note"]
        holes = next((f for f in report.findings if f.what == "view-holes"), None)
        lines = [f"{f.level}: {f.what}: {f.text}" for f in found if f is not holes]
        lines.append(
            f"{holes.text}"
            if holes is not None
            else "no holes in a robot's views"
            if report.free_floor
            else "no position is free for a robot"
        )
        return lines

    def _compare(self, progress: Progress) -> Sequence[str]:
        facts = self._read("texture")
        photographs = self.found.photographs.subset(facts["numbers"]).with_poses(np.array(facts["T_world_camera"]))
        numbers, done = facts["held_out"], 0
        pixels = sum(photographs.intrinsics(k).width * photographs.intrinsics(k).height for k in numbers)
        with photograph_renderer(load_scene(self.output), photographs, UNSEEN_FLOOR) as draw:

            def counted(number: int) -> RenderedImage:
                nonlocal done
                done += 1
                progress((0.5 if self.settings.fill else 0.9) * done / len(numbers))
                return draw(number)

            alike = image_similarity(photographs, counted, numbers=numbers)
            filled = self._compare_filled(photographs, numbers, draw) if self.settings.fill else {}
            sheet = contact_sheet(photographs, draw, numbers, self._unused())
        share = alike.pixels / pixels
        write_picture(self.output / SHEET, sheet[:, :, ::-1])
        self._write(
            "likeness",
            {
                "psnr": alike.psnr,
                "ssim": alike.ssim,
                "seen": share,
                "photographs": len(numbers),
                "filled": {region: [asdict(one) for one in both] for region, both in filled.items()},
            },
        )
        lines = [
            f"{len(numbers)} held-out photographs ({self._unused()}), re-rendered: PSNR {alike.psnr:.1f} dB, SSIM {alike.ssim:.2f}, "
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
        return lines

    def _compare_filled(
        self, photographs: Photographs, numbers: Sequence[int], draw: DrawPhotograph
    ) -> dict[str, tuple[ImageSimilarity, ImageSimilarity]]:
        """Returns region -> likeness of images as drawn, and with their holes filled."""

        def alike(fill: str, region: str) -> ImageSimilarity:
            return image_similarity(photographs, lambda number: draw(number, fill, region), numbers=numbers)

        return {region: (alike("", region), alike(self.settings.fill, region)) for region in (FRONTS, HOLES)}

    def _T_level_scan(self) -> F64:
        return np.array(self._read("level")["T_level_scan"])

    def _level_photographs(self, T_level_scan: F64) -> Photographs:
        return self.found.photographs.with_poses(T_level_scan @ np.array(self._read("fused")["T_scan_camera"]))

    def _read_mesh(self, name: str) -> ColouredMesh:
        path = self.output / name
        surface = surface_from_mesh(load_mesh(path, [path.parent]))
        assert surface.colors is not None
        return ColouredMesh(surface.vertices.astype(np.float32), surface.triangles.astype(np.int32), surface.colors)

    def _read(self, name: str) -> Any:
        return json.loads(read_file(self.output / _FACTS[name], _MOST_BYTES))

    def _write(self, name: str, values: Any) -> None:
        write_file(self.output / _FACTS[name], json.dumps(values))


def _state(path: Path) -> tuple[str, int, int]:
    """Returns what tells whether a file changed; a missing file is found by the stage that reads it."""
    try:
        status = path.stat()
    except OSError:
        return str(path), -1, -1
    return str(path), status.st_size, status.st_mtime_ns


def _simplified(mesh: ColouredMesh, triangles: int) -> ColouredMesh:
    try:
        return simplified(mesh, triangles)
    except EnvironmentProblemError:
        # A mesh that came with the photographs needs no Open3D.
        return thinned(mesh, triangles)


def _replaced(scene: ImportedScene, output: Path) -> None:
    """Writes a scene into a folder that has other files."""
    fresh = output / WORK / "scene"
    shutil.rmtree(fresh, ignore_errors=True)
    write_scene(scene, fresh)
    try:
        shutil.rmtree(output / ASSETS, ignore_errors=True)
        (fresh / ASSETS).rename(output / ASSETS)
        (fresh / DESCRIPTION).replace(output / DESCRIPTION)
        shutil.rmtree(fresh)
    except OSError as error:
        raise cannot_write(output, error) from error


def _map_text(floor: FloorMap, number: int, count: int) -> str:
    cell = floor.resolution**2
    region = float(floor.largest_free_region(MAP_ROBOT.radius).sum()) * cell
    where = f"floor {number}: " if count > 1 else ""
    return f"{where}{float(floor.free.sum()) * cell:.1f} m^2 free, {region:.1f} m^2 of them for a robot of radius {MAP_ROBOT.radius:g} m"
