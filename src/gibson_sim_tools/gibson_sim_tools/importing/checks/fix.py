"""Writes a repaired copy of a scene: level, in metres, with consistent winding and textures within the size limit."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.description.omissions import Omission, OmissionKind, kind_of
from gibson_sim.description.shapes import Appearance, Shape
from gibson_sim.errors import SceneError
from gibson_sim.formats.load_mesh import MeshLoader
from gibson_sim.formats.mesh import LightMapSource, Material, Mesh, MeshPart, TextureSource
from gibson_sim.formats.textures import decode_image, decode_light_map
from gibson_sim.geometry.transforms import matrix_from_pose
from gibson_sim.geometry.triangle_meshes import areas_of, unit_normals
from gibson_sim.maps.export import FLOORS
from gibson_sim.maps.free_poses import FREE_POSES
from gibson_sim.quoting import quoted
from gibson_sim.scenes.room_spec import RoomSpec
from gibson_sim.scenes.scene_meshes import scene_roots
from gibson_sim.scenes.scene_yaml import DESCRIPTION
from gibson_sim.scenes.spec import SceneSpec, SplatsSpec
from gibson_sim.types import Pose, Vec3
from gibson_sim.writing import cannot_write, write_file
from gibson_sim_tools.importing.checks.check import MAX_SIDE, NEED_UPRIGHT, SceneReport, check_path, left_out
from gibson_sim_tools.importing.checks.facts import declares_up, original_up
from gibson_sim_tools.importing.checks.faults import find_faults
from gibson_sim_tools.importing.checks.gravity import ON_ITS_SIDE_DEG, guess_up, refine_up, rotation_to_z
from gibson_sim_tools.importing.checks.splat_alignment import align_splats, moved_splats
from gibson_sim_tools.importing.checks.splats import visual_line, write_visual
from gibson_sim_tools.importing.document import ASSETS, SIMPLIFIED, ImportedObject, ImportedScene, write_scene
from gibson_sim_tools.importing.importers import WITHOUT_VISUAL, collisions_by_visual, light_document
from gibson_sim_tools.importing.labels import select_triangles
from gibson_sim_tools.importing.scene_files import THUMBNAIL

F64 = NDArray[np.float64]
MAX_MAP_TILT_DEG = 2.0
"""Tilt up to which a map of the scene is meaningful, degrees."""
_MIN_LEVEL_Z = 0.95
"""Minimum z component of a level triangle's unit normal."""
_FLOOR_SEARCH_RANGE = 0.3
"""Search range around the transformed height of a floor, m."""
_FILES_IN_ITS_FRAME = ("maps", "floor_trav_*.png", FLOORS, FREE_POSES, THUMBNAIL)
"""Files beside a scene that are valid in its frame only."""
_OTHER_FILES = ("LICENSE*", "LICENCE*", "README*")
MAX_SOURCE_PIXELS = 16384 * 16384
"""Size limit of an image that can be scaled down, pixels."""


@dataclass(frozen=True, slots=True)
class _Amount:
    """Measure of a kind of finding."""

    name: str
    """Name of the measure, for messages."""
    unit: str = ""
    """Unit; empty = a count."""
    noise: float = 0.0
    """Relative difference of two measurements of the same scene."""
    slack: float = 0.0
    """Absolute difference of two measurements of the same scene, in its unit."""


_AMOUNTS = {
    "no-floor": _Amount("missing floors"),
    "floor-faces-down": _Amount("floors that face down"),
    "no-room": _Amount("floors without room for a robot"),
    "start-blocked": _Amount("start poses that are not free"),
    "islands": _Amount("pieces of the free floor"),
    "out-of-date": _Amount("free poses and files that no longer fit"),
    "degenerate": _Amount("triangles without area"),
    "inverted": _Amount("inverted triangles"),
    "non-manifold": _Amount("non-manifold edges"),
    "holes": _Amount("open boundaries", "m", 0.01, 0.3),
    "view-holes": _Amount("holes in the views of a robot", "%", 0.05, 0.01),
    "splats-apart": _Amount("distance of half of the splats from the mesh", "m", 0.05, 0.005),
    "missing": _Amount("missing files"),
    "missing-texture": _Amount("missing textures"),
    "huge-texture": _Amount("textures that are too large"),
    "textures-memory": _Amount("memory of all textures", "MB", 0.0, 1.0),
}
"""Measure of each kind of finding."""
_METRIC = {"holes", "splats-apart"}
"""Findings whose amount is meaningful only for a scene in metres."""
_ROUNDING, _ROUNDING_SHARE = {"degenerate", "inverted", "non-manifold"}, 0.001
"""Findings that rounding of coordinates may cause, and the fraction of all triangles it may affect."""
_FLOOR_NOISE, _FLOOR_SLACK = 0.05, 0.3
"""Relative and absolute (m^2) noise of the free floor area, since rotation shifts the cells of a map."""
_TILT_NOISE_DEG = 0.1
"""Noise of the tilt, degrees."""


@dataclass(frozen=True, slots=True)
class FixOptions:
    """Options of a repair."""

    unit_m: float | None = None
    """Metres per unit of the scene; None = 1."""
    max_texture: int = MAX_SIDE
    """Longest side of a texture, pixels."""
    level: bool = True
    """Whether to rotate the scene so that its floor is level."""
    up: Vec3 | None = None
    """Approximate up direction, unit vector, refined with the level surfaces near it; None = estimated from the surfaces, if that is reliable."""


def fix_scene(report: SceneReport, output: Path, fix: FixOptions) -> tuple[Path, SceneReport]:
    """Writes a repaired copy of a scene and checks it; removes the copy if it is worse than the scene.

    Args:
        report: report on the scene.
        output: new folder for the copy.
        fix: options of the repair.

    Returns:
        The scene.yaml, and the report on it.

    Raises:
        SceneError: the scene cannot be read, the folder cannot be written, or the copy would be worse.
    """
    if report.scene is None or report.geometry is None:
        raise SceneError(f"the scene cannot be read, so nothing can be repaired: {report.findings[0].text}")
    if report.scene.bodies:
        raise SceneError(f"scene {quoted(report.scene.name)} has movable bodies; repair their meshes one by one")
    scene = report.scene
    matrix = np.eye(4)
    if fix.level:
        g = report.geometry
        up = (
            guess_up(g.vertices, g.triangles, original_up(scene), declares_up(scene)).up
            if fix.up is None
            else refine_up(g.vertices, g.triangles, fix.up)
        )
        matrix[:3, :3] = rotation_to_z(up)
    matrix[:3, :3] *= fix.unit_m or 1.0
    textures = _Textures(fix.max_texture)
    out = ImportedScene(scene.name, "repaired scene", scene.root)
    is_transformed = not np.allclose(matrix, np.eye(4), atol=1e-6)
    if matrix[2, 2] >= np.cos(np.radians(ON_ITS_SIDE_DEG)) * (fix.unit_m or 1.0):
        # Floor heights and rooms of a scene on its side are meaningless.
        out.ground_friction = scene.ground_friction
        out.floors, out.ground_z, out.rooms = (
            (scene.floors, scene.ground_z, scene.rooms) if not is_transformed else _transformed_floors(report, matrix)
        )
        if is_transformed and scene.floor_estimated:
            # Floor heights estimated in a tilted scene are wrong; loading the repaired scene estimates them again.
            out.floors = ()
    out.light, out.gravity = light_document(scene.light), None if scene.gravity == (0.0, 0.0, -9.81) else scene.gravity
    out.starts = [_start(s.name, s.pose, matrix) for s in scene.starts]
    out.objects = list(_repaired_objects(scene, matrix, textures))
    out.warnings = [line for line in left_out(scene, report.geometry) if kind_of(line) is not OmissionKind.UP_UNCLEAR]
    out.warnings += [
        Omission(f.text, OmissionKind.UP_UNCLEAR) for f in report.findings if f.what == "up-unclear" and fix.up is None
    ]
    file = write_scene(out, output)
    if scene.splats is not None:
        _carry_splats(scene.splats, matrix, file)
    _carry_files(scene.root, file.parent, is_transformed)
    report_after = check_path(file)
    if scene.splats is not None and any(finding.what == "splats-apart" for finding in report_after.findings):
        report_after = _align_splats_of_copy(report_after, file)
    worse = regressions(report, report_after)
    if worse:
        shutil.rmtree(output, ignore_errors=True)
        raise SceneError(
            f"nothing was written: a repaired copy of {quoted(scene.name)} would be worse than it is: {'; '.join(worse)}"
            + ("; --no-level keeps its orientation, --up gives the up direction" if is_transformed else "")
        )
    return file, report_after


def has_repairs(report: SceneReport, fix: FixOptions) -> bool:
    """Returns whether ``fix_scene`` would change a scene, or whether it cannot tell: the scene cannot be read, or its up direction is unclear."""
    if report.facts is None or fix.up is not None or fix.unit_m not in (None, 1.0):
        return True
    ignored = {"not-metres"} | (set() if fix.level else {"not-level"})
    return any((f.fixable or f.what == "up-unclear") and f.what not in ignored for f in report.findings) or any(
        max(texture.width, texture.height) > fix.max_texture for texture in report.facts.textures
    )


def left_behind(root: Path, output: Path) -> list[str]:
    """Returns the names of the maps and other files beside a scene that its repaired copy lacks, because they no longer fit it."""
    return [path.name for path in _files_beside(root, (*_FILES_IN_ITS_FRAME, *_OTHER_FILES)) if not (output / path.name).exists()]


def _carry_files(root: Path, output: Path, is_transformed: bool) -> None:
    """Copies the files beside a scene to its repaired copy: licences, and those in the frame of the scene unless that was transformed."""
    for path in _files_beside(root, _OTHER_FILES if is_transformed else (*_FILES_IN_ITS_FRAME, *_OTHER_FILES)):
        copy = output / path.name
        try:
            if path.is_dir():
                shutil.copytree(path, copy, dirs_exist_ok=True)
            else:
                shutil.copyfile(path, copy)
        except OSError as e:
            shutil.rmtree(output, ignore_errors=True)
            raise cannot_write(copy, e) from e


def _files_beside(root: Path, patterns: Sequence[str]) -> list[Path]:
    """Returns the files and folders that match patterns in the folder of a scene.yaml; none without one. Symbolic links are left out."""
    if not (root / DESCRIPTION).is_file():
        return []
    return [path for pattern in patterns for path in sorted(root.glob(pattern)) if not path.is_symlink()]


def regressions(before: SceneReport, after: SceneReport) -> list[str]:
    """Returns the regressions of a repaired copy, one line each: new problems, and measures that grew beyond their noise.

    Findings that could not appear in the original do not count: a map of a scene on its side or in inches is meaningless.
    """
    known_kinds = {f.what for f in before.findings if f.level != "note"}
    comparable = (
        before.facts is not None
        and before.facts.upright
        and before.facts.unit == "m"
        and before.facts.tilt_deg <= MAX_MAP_TILT_DEG
    )
    # A map of a sloping floor shows no islands.
    hidden_kinds = {"islands"} if "not-level" in known_kinds else set()
    new_findings = [
        f
        for f in after.findings
        if f.level != "note" and f.what not in known_kinds | hidden_kinds and (comparable or f.what not in NEED_UPRIGHT)
    ]
    lines = [f.text for f in new_findings]
    skipped_kinds = hidden_kinds | {f.what for f in new_findings} | (set() if comparable else NEED_UPRIGHT | _METRIC)
    count = 0 if after.facts is None else after.facts.triangles
    amounts = before.amounts, after.amounts
    for what, a in _AMOUNTS.items():
        old, new = (amount.get(what, 0.0) for amount in amounts)
        if what not in skipped_kinds and new > old * (1.0 + a.noise) + a.slack + (
            count * _ROUNDING_SHARE if what in _ROUNDING else 0.0
        ):
            lines.append(f"{a.name}: {_number(new, a.unit)}, {_number(old, a.unit)} before")
    free_areas = (before.free_floor, after.free_floor) if comparable else (None, None)
    if (
        free_areas[0] is not None
        and free_areas[1] is not None
        and free_areas[1] < free_areas[0] * (1.0 - _FLOOR_NOISE) - _FLOOR_SLACK
    ):
        lines.append(f"floor that is free for a robot: {free_areas[1]:.1f} m^2, {free_areas[0]:.1f} m^2 before")
    if after.facts is not None and before.facts is not None and before.facts.up_axis and after.facts.up_axis:
        tilts = before.facts.tilt_deg, after.facts.tilt_deg
        if tilts[1] > tilts[0] + _TILT_NOISE_DEG and "not-level" not in {f.what for f in new_findings}:
            lines.append(f"the floor is {tilts[1]:.2f} degrees out of level, {tilts[0]:.2f} before")
    return lines


def _number(value: float, unit: str) -> str:
    return f"{100.0 * value:.1f} %" if unit == "%" else f"{value:.1f} {unit}" if unit else f"{value:.0f}"


def _transformed_floors(report: SceneReport, matrix: F64) -> tuple[tuple[float, ...], float | None, tuple[RoomSpec, ...]]:
    """Returns the floor heights, the ground height and the rooms in the repaired scene."""
    scene, g = report.scene, report.geometry
    if scene is None or g is None:
        return (), None, ()
    low, high = g.vertices.min(axis=0), g.vertices.max(axis=0)

    def height(z: float, places: Sequence[tuple[float, float]]) -> float:
        x, y = np.mean(places, axis=0) if len(places) else (low + high)[:2] / 2
        return float((matrix @ (x, y, z, 1.0))[2])

    corners = (g.vertices @ matrix[:3, :3].T)[g.triangles]
    is_level = np.abs(unit_normals(corners)[:, 2]) > _MIN_LEVEL_Z
    heights, areas = corners[is_level, :, 2].mean(axis=1), areas_of(corners[is_level])
    floors = []
    for number, z in enumerate(scene.floors):
        room_corners = [place for room in scene.rooms if room.floor == number for place in room.polygon]
        start_positions = [
            (s.pose.position[0], s.pose.position[1]) for s in scene.starts if abs(s.pose.position[2] - z) < _FLOOR_SEARCH_RANGE
        ]
        floors.append(_level_height(height(z, room_corners or start_positions), heights, areas))
    rooms = []
    for room in scene.rooms:
        z = scene.floors[min(room.floor, len(scene.floors) - 1)]
        polygon = tuple((float(p[0]), float(p[1])) for p in (matrix @ (x, y, z, 1.0) for x, y in room.polygon))
        rooms.append(replace(room, polygon=polygon))
    ground = None if scene.ground_z is None else height(scene.ground_z, [])
    if ground is not None:
        # A ground plane at the height of a floor stays at that floor.
        ground = next((new for new, old in zip(floors, scene.floors, strict=True) if abs(old - scene.ground_z) < 1e-6), ground)  # type: ignore[operator]
    return tuple(sorted(floors)), ground, tuple(rooms)


def _level_height(expected: float, heights: F64, areas: F64) -> float:
    """Returns the area-weighted median height of the level surfaces near a height, m; that height without any."""
    is_near = np.abs(heights - expected) <= _FLOOR_SEARCH_RANGE
    if not is_near.any():
        return expected
    order = np.argsort(heights[is_near])
    sums = np.cumsum(areas[is_near][order])
    return float(heights[is_near][order][int(np.searchsorted(sums, sums[-1] / 2))])


def _carry_splats(splats: SplatsSpec, matrix: F64, file: Path) -> None:
    """Copies the splats of a scene into its repaired copy, transformed by ``matrix``, (4, 4)."""
    copy = file.parent / ASSETS / Path(splats.file).name
    try:
        copy.parent.mkdir(exist_ok=True)
        shutil.copyfile(splats.file, copy)
    except OSError as e:
        shutil.rmtree(file.parent, ignore_errors=True)
        raise cannot_write(copy, e) from e
    line = visual_line(moved_splats(splats, matrix), copy.relative_to(file.parent).as_posix())
    write_file(file, f"{file.read_text(encoding='utf-8')}{line}\n")


def _align_splats_of_copy(report: SceneReport, file: Path) -> SceneReport:
    """Registers the splats of a repaired copy to its mesh; returns the new report, or the old one if no pose is found."""
    if report.scene is None or report.scene.splats is None or report.geometry is None:
        return report
    g = report.geometry
    try:
        write_visual(file, align_splats(report.scene.splats, g.vertices[g.triangles], np.random.default_rng(0)).spec)
    except SceneError:
        return report
    return check_path(file)


def _start(name: str, pose: Pose, matrix: F64) -> dict[str, object]:
    T_out_start = matrix @ matrix_from_pose(pose)
    yaw = float(np.degrees(np.arctan2(T_out_start[1, 0], T_out_start[0, 0])))
    return {"name": name, "xyz": [round(float(c), 6) for c in T_out_start[:3, 3]], "yaw_deg": round(yaw, 4)}


def _repaired_objects(scene: SceneSpec, matrix: F64, textures: _Textures) -> Sequence[ImportedObject]:
    loader = MeshLoader(scene_roots(scene), textures="sizes")
    shapes_by_visual = collisions_by_visual(scene)
    out = []
    for visual in scene.visuals:
        mesh = _repaired(loader, visual.shape, matrix @ matrix_from_pose(visual.pose), textures)
        shapes = shapes_by_visual.get(visual.name, [])
        appearance = Appearance() if visual.appearance is None else visual.appearance
        item = ImportedObject(
            visual.name, mesh, semantic_class=visual.semantic_class, color=visual.color, collision="none", metallic=appearance.metallic,
            roughness=appearance.roughness, friction=shapes[0].friction if shapes else 1.0,
        )  # fmt: skip
        if len(shapes) == 1 and shapes[0].shape == visual.shape and shapes[0].pose == visual.pose:
            item = replace(item, collision="same")
        elif len(shapes) > 1 and len({c.name for c in shapes}) == 1:
            # Several shapes with one name are those of a scan; they are recomputed from the repaired mesh.
            item = replace(item, collision=SIMPLIFIED)
        elif shapes:
            meshes = [_repaired(loader, c.shape, matrix @ matrix_from_pose(c.pose), None) for c in shapes]
            item = replace(item, collision=Mesh(tuple(part for m in meshes for part in m.parts)))
        if item.shape.parts:  # type: ignore[union-attr]
            out.append(item)
    for unseen in shapes_by_visual.get(WITHOUT_VISUAL, []):
        mesh = _repaired(loader, unseen.shape, matrix @ matrix_from_pose(unseen.pose), None)
        if mesh.parts:
            out.append(ImportedObject(unseen.name, mesh, visible=False, friction=unseen.friction))
    return out


def _repaired(loader: MeshLoader, shape: Shape, matrix: F64, textures: _Textures | None) -> Mesh:
    """Returns the mesh of a shape, transformed into the repaired scene, without degenerate or inverted triangles."""
    mesh = loader.shape(shape)
    vertices, triangles = mesh.merged()
    faults = find_faults(vertices, triangles)
    ends = np.cumsum([len(part.triangles) for part in mesh.parts])[:-1]
    parts = []
    for part, flat, inverted in zip(mesh.parts, np.split(faults.degenerate, ends), np.split(faults.inverted, ends), strict=True):
        flipped = _flip_triangles(part, inverted)
        valid = select_triangles(flipped, ~flat) if flat.any() else flipped
        if not len(valid.triangles):
            continue
        plain = replace(valid, uvs=None, colors=None, light_uvs=None, material=Material()) if textures is None else valid
        parts.append(plain if textures is None else replace(plain, material=textures.material(plain.material, loader)))
    return Mesh(tuple(parts)).transformed(matrix)


def _flip_triangles(part: MeshPart, inverted: NDArray[np.bool_]) -> MeshPart:
    """Returns a part with the winding and the normals of the ``inverted`` triangles, (F,), flipped."""
    if not inverted.any():
        return part
    unflipped, flipped = select_triangles(part, ~inverted), select_triangles(part, inverted)
    flipped = replace(flipped, normals=-flipped.normals, triangles=np.ascontiguousarray(flipped.triangles[:, ::-1]))

    return MeshPart(
        np.concatenate([unflipped.vertices, flipped.vertices]),
        np.concatenate([unflipped.normals, flipped.normals]),
        None if unflipped.uvs is None or flipped.uvs is None else np.concatenate([unflipped.uvs, flipped.uvs]),
        np.concatenate([unflipped.triangles, flipped.triangles + np.uint32(len(unflipped.vertices))]),
        part.material,
        None if unflipped.colors is None or flipped.colors is None else np.concatenate([unflipped.colors, flipped.colors]),
        None
        if unflipped.light_uvs is None or flipped.light_uvs is None
        else np.concatenate([unflipped.light_uvs, flipped.light_uvs]),
    )


class _Textures:
    """Decodes the textures of materials one by one and scales them down to a maximum side, pixels."""

    def __init__(self, max_side: int) -> None:
        self._max_side = max_side
        self._by_id: dict[int, TextureSource | None] = {}
        self._originals: list[TextureSource] = []
        self._light_maps: dict[int, tuple[LightMapSource, LightMapSource | None]] = {}

    def material(self, material: Material, loader: MeshLoader) -> Material:
        names = ("texture", "metallic_roughness_texture", "normal_texture", "occlusion_texture", "emissive_texture")
        changes: dict[str, object] = {
            name: self._image(getattr(material, name), loader) for name in names if getattr(material, name) is not None
        }
        if material.light_map is not None:
            changes["light_map"] = self._light_map(material.light_map, loader)
        return replace(material, **changes) if changes else material  # type: ignore[arg-type]

    def _light_map(self, light_map: LightMapSource, loader: MeshLoader) -> LightMapSource | None:
        """Returns a light map with its pixels and in its size: its charts have borders for no other."""
        if id(light_map) not in self._light_maps:
            pixels = decode_light_map(loader.image_bytes(light_map))
            self._light_maps[id(light_map)] = (light_map, None if pixels is None else LightMapSource(light_map.name, pixels))
        return self._light_maps[id(light_map)][1]

    def _image(self, texture: TextureSource, loader: MeshLoader) -> TextureSource | None:
        if id(texture) not in self._by_id:
            self._originals.append(texture)
            self._by_id[id(texture)] = self._read(texture, loader)
        return self._by_id[id(texture)]

    def _read(self, texture: TextureSource, loader: MeshLoader) -> TextureSource | None:
        rows, columns = texture.pixels.shape[:2]
        if rows * columns > MAX_SOURCE_PIXELS:
            raise SceneError(f"{texture.name}: has {columns} x {rows} pixels, too many to scale it down; use an image editor")
        data = loader.image_bytes(texture)
        pixels = decode_image(data) if data else None
        if pixels is None:
            return None
        factor = self._max_side / max(rows, columns)
        if factor < 1.0:
            size = (max(1, round(columns * factor)), max(1, round(rows * factor)))
            pixels = np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        return TextureSource(texture.name, pixels, texture.sampling)
