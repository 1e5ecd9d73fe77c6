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
from gibson_sim.description.shapes import Shape
from gibson_sim.errors import SceneError
from gibson_sim.formats.load_mesh import MeshLoader
from gibson_sim.formats.mesh import Material, Mesh, MeshPart, TextureSource
from gibson_sim.formats.textures import decode_image
from gibson_sim.geometry.transforms import matrix_from_pose
from gibson_sim.geometry.triangles import areas_of, unit_normals
from gibson_sim.quoting import quoted
from gibson_sim.scenes.room_spec import RoomSpec
from gibson_sim.scenes.scene_meshes import scene_roots
from gibson_sim.scenes.spec import SceneSpec, SplatsSpec
from gibson_sim.types import Pose, Vec3
from gibson_sim.writing import cannot_write, write_file
from gibson_sim_tools.importing.checks.check import MAX_SIDE, NEED_UPRIGHT, SceneReport, check_path, left_out
from gibson_sim_tools.importing.checks.facts import former_up, is_told
from gibson_sim_tools.importing.checks.faults import find_faults
from gibson_sim_tools.importing.checks.gravity import ON_ITS_SIDE_DEG, guess_up, level_near, rotation_to_z
from gibson_sim_tools.importing.checks.splat_alignment import align_splats, moved_splats
from gibson_sim_tools.importing.checks.splats_in_yaml import visual_line, write_visual
from gibson_sim_tools.importing.document import ASSETS, SIMPLIFIED, ImportedObject, ImportedScene, write_scene
from gibson_sim_tools.importing.importers import UNSEEN, assigned, light_document
from gibson_sim_tools.importing.labels import some_triangles

F64 = NDArray[np.float64]
TOLD_DEG = 2.0
"""Tilt above which a map of the scene is meaningless, degrees."""
_LEVEL = 0.95
"""Least z component of a level triangle's unit normal."""
_SNAP = 0.3
"""Search range around the rotated height of a floor, metres."""
MOST_PIXELS = 16384 * 16384
"""Size limit of an image that can be scaled down."""


@dataclass(frozen=True, slots=True)
class _Amount:
    """What the amount of a kind of finding measures."""

    name: str
    unit: str = ""
    noise: float = 0.0
    """Part by which two measurements of the same scene may differ."""
    slack: float = 0.0
    """The same in its unit."""


_AMOUNTS = {
    "no-floor": _Amount("floors that are missing"),
    "floor-faces-down": _Amount("floors that face down"),
    "no-room": _Amount("floors without room for a robot"),
    "start-blocked": _Amount("start poses that are not free"),
    "islands": _Amount("pieces of the free floor"),
    "out-of-date": _Amount("free poses and files that no longer fit"),
    "degenerate": _Amount("triangles without area"),
    "inverted": _Amount("inverted triangles"),
    "non-manifold": _Amount("non-manifold edges"),
    "holes": _Amount("open rims", "m", 0.01, 0.3),
    "view-holes": _Amount("holes in the views of a robot", "%", 0.05, 0.01),
    "splats-apart": _Amount("distance of half of the splats from the mesh", "m", 0.05, 0.005),
    "missing": _Amount("missing files"),
    "missing-texture": _Amount("missing textures"),
    "huge-texture": _Amount("textures that are too large"),
    "textures-memory": _Amount("memory of all textures", "MB", 0.0, 1.0),
}
"""What the amount of each kind of finding means."""
_METRIC = {"holes", "splats-apart"}
"""Findings whose amount is meaningless unless the scene is in metres."""
_COUNTED, _FEW = {"degenerate", "inverted", "non-manifold"}, 0.001
"""Findings that rounding of coordinates may cause, and the share of all triangles that it may."""
_FLOOR_NOISE, _FLOOR_SLACK = 0.05, 0.3
"""Noise of the area of the free floor: relative, and square metres. A turned map has its cells elsewhere."""
_TILT_NOISE_DEG = 0.1
"""Noise of the tilt, degrees."""


@dataclass(frozen=True, slots=True)
class FixOptions:
    """Options of a repair."""

    unit_m: float | None = None
    """Metres per unit of the scene; None = it is in metres."""
    max_texture: int = MAX_SIDE
    """Longest side, pixels."""
    level: bool = True
    """Rotate the scene so that its floor is level."""
    up: Vec3 | None = None
    """Approximate up direction, unit vector, refined by the level surfaces near it; None = estimated from the surfaces, if that is sure."""


def fix_scene(report: SceneReport, output: Path, fix: FixOptions) -> tuple[Path, SceneReport]:
    """Writes a repaired copy of a scene and checks it; a copy that is worse than the scene is removed.

    Args:
        report: of the scene.
        output: new folder.
        fix: options.

    Returns:
        The scene.yaml, and the report on it.

    Raises:
        SceneError: the scene cannot be read, the folder cannot be written, or the copy would be worse.
    """
    if report.scene is None or report.geometry is None:
        raise SceneError(f"the scene cannot be read, so nothing can be repaired: {report.findings[0].text}")
    if report.scene.bodies:
        raise SceneError(f"scene {quoted(report.scene.name)} has bodies that move; repair its meshes one by one")
    scene = report.scene
    matrix = np.eye(4)
    if fix.level:
        g = report.geometry
        up = (
            guess_up(g.vertices, g.triangles, former_up(scene), is_told(scene)).up
            if fix.up is None
            else level_near(g.vertices, g.triangles, fix.up)
        )
        matrix[:3, :3] = rotation_to_z(up)
    matrix[:3, :3] *= fix.unit_m or 1.0
    textures = _Textures(fix.max_texture)
    out = ImportedScene(scene.name, "mended scene", scene.root)
    moved = not np.allclose(matrix, np.eye(4), atol=1e-6)
    if matrix[2, 2] >= np.cos(np.radians(ON_ITS_SIDE_DEG)) * (fix.unit_m or 1.0):
        # Floor heights and rooms of a scene on its side are meaningless.
        out.floors, out.ground_z, out.rooms = (
            (scene.floors, scene.ground_z, scene.rooms) if not moved else _turned_floors(report, matrix)
        )
        if moved and scene.floor_estimated:
            # An estimate in a tilted scene is wrong; loading the repaired scene estimates anew.
            out.floors = ()
    out.light, out.gravity = light_document(scene.light), None if scene.gravity == (0.0, 0.0, -9.81) else scene.gravity
    out.starts = [_start(s.name, s.pose, matrix) for s in scene.starts]
    out.objects = list(_objects(scene, matrix, textures))
    out.warnings = [line for line in left_out(scene, report.geometry) if kind_of(line) is not OmissionKind.UP_UNCLEAR]
    out.warnings += [
        Omission(f.text, OmissionKind.UP_UNCLEAR) for f in report.findings if f.what == "up-unclear" and fix.up is None
    ]
    file = write_scene(out, output)
    if scene.splats is not None:
        _carry_splats(scene.splats, matrix, file)
    mended = check_path(file)
    if scene.splats is not None and any(finding.what == "splats-apart" for finding in mended.findings):
        mended = _aligned(mended, file)
    worse = made_worse(report, mended)
    if worse:
        shutil.rmtree(output, ignore_errors=True)
        raise SceneError(
            f"nothing was written: a repaired copy of {quoted(scene.name)} would be worse than it is: {'; '.join(worse)}"
            + ("; --no-level leaves it turned as it is, --up says which way is up" if moved else "")
        )
    return file, mended


def made_worse(before: SceneReport, after: SceneReport) -> list[str]:
    """Returns what got worse in a repaired copy, one line each: new problems, and every measure of ``check`` that grew beyond its noise.

    What the scene could not show does not count: a map of a scene on its side or in inches is meaningless.
    """
    known = {f.what for f in before.findings if f.level != "note"}
    told = before.facts is not None and before.facts.upright and before.facts.unit == "m" and before.facts.tilt_deg <= TOLD_DEG
    # A map of a sloping floor shows no islands.
    hidden = {"islands"} if "not-level" in known else set()
    fresh = [
        f for f in after.findings if f.level != "note" and f.what not in known | hidden and (told or f.what not in NEED_UPRIGHT)
    ]
    out = [f.text for f in fresh]
    skipped = hidden | {f.what for f in fresh} | (set() if told else NEED_UPRIGHT | _METRIC)
    count = 0 if after.facts is None else after.facts.triangles
    amounts = before.amounts, after.amounts
    for what, a in _AMOUNTS.items():
        old, new = (amount.get(what, 0.0) for amount in amounts)
        if what not in skipped and new > old * (1.0 + a.noise) + a.slack + (count * _FEW if what in _COUNTED else 0.0):
            out.append(f"{a.name}: {_number(new, a.unit)}, {_number(old, a.unit)} before")
    areas = (before.free_floor, after.free_floor) if told else (None, None)
    if areas[0] is not None and areas[1] is not None and areas[1] < areas[0] * (1.0 - _FLOOR_NOISE) - _FLOOR_SLACK:
        out.append(f"floor that is free for a robot: {areas[1]:.1f} m^2, {areas[0]:.1f} m^2 before")
    if after.facts is not None and before.facts is not None and before.facts.up_axis and after.facts.up_axis:
        tilts = before.facts.tilt_deg, after.facts.tilt_deg
        if tilts[1] > tilts[0] + _TILT_NOISE_DEG and "not-level" not in {f.what for f in fresh}:
            out.append(f"the floor is {tilts[1]:.2f} degrees out of level, {tilts[0]:.2f} before")
    return out


def _number(value: float, unit: str) -> str:
    return f"{100.0 * value:.1f} %" if unit == "%" else f"{value:.1f} {unit}" if unit else f"{value:.0f}"


def _turned_floors(report: SceneReport, matrix: F64) -> tuple[tuple[float, ...], float | None, tuple[RoomSpec, ...]]:
    """Returns the floor heights, the ground and the rooms in the repaired scene."""
    scene, g = report.scene, report.geometry
    if scene is None or g is None:
        return (), None, ()
    low, high = g.vertices.min(axis=0), g.vertices.max(axis=0)

    def height(z: float, places: Sequence[tuple[float, float]]) -> float:
        x, y = np.mean(places, axis=0) if len(places) else (low + high)[:2] / 2
        return float((matrix @ (x, y, z, 1.0))[2])

    corners = (g.vertices @ matrix[:3, :3].T)[g.triangles]
    level = np.abs(unit_normals(corners)[:, 2]) > _LEVEL
    heights, areas = corners[level, :, 2].mean(axis=1), areas_of(corners[level])
    floors = []
    for number, z in enumerate(scene.floors):
        inside = [place for room in scene.rooms if room.floor == number for place in room.polygon]
        stands = [(s.pose.position[0], s.pose.position[1]) for s in scene.starts if abs(s.pose.position[2] - z) < _SNAP]
        floors.append(_level_height(height(z, inside or stands), heights, areas))
    rooms = []
    for room in scene.rooms:
        z = scene.floors[min(room.floor, len(scene.floors) - 1)]
        polygon = tuple((float(p[0]), float(p[1])) for p in (matrix @ (x, y, z, 1.0) for x, y in room.polygon))
        rooms.append(replace(room, polygon=polygon))
    ground = None if scene.ground_z is None else height(scene.ground_z, [])
    if ground is not None:
        # Ground at the height of a floor stays at that floor.
        ground = next((new for new, old in zip(floors, scene.floors, strict=True) if abs(old - scene.ground_z) < 1e-6), ground)  # type: ignore[operator]
    return tuple(sorted(floors)), ground, tuple(rooms)


def _level_height(about: float, heights: F64, areas: F64) -> float:
    """Returns the area-weighted median height of the level surfaces near a height; that height if there are none."""
    near = np.abs(heights - about) <= _SNAP
    if not near.any():
        return about
    order = np.argsort(heights[near])
    sums = np.cumsum(areas[near][order])
    return float(heights[near][order][int(np.searchsorted(sums, sums[-1] / 2))])


def _carry_splats(splats: SplatsSpec, matrix: F64, file: Path) -> None:
    """Copies the splats of a scene into a mended copy, in which everything was transformed by ``matrix``."""
    copy = file.parent / ASSETS / Path(splats.file).name
    try:
        copy.parent.mkdir(exist_ok=True)
        shutil.copyfile(splats.file, copy)
    except OSError as e:
        shutil.rmtree(file.parent, ignore_errors=True)
        raise cannot_write(copy, e) from e
    line = visual_line(moved_splats(splats, matrix), copy.relative_to(file.parent).as_posix())
    write_file(file, f"{file.read_text(encoding='utf-8')}{line}\n")


def _aligned(report: SceneReport, file: Path) -> SceneReport:
    """Returns the report on a mended copy after its splats are brought onto its mesh; the same one if no pose is found."""
    if report.scene is None or report.scene.splats is None or report.geometry is None:
        return report
    g = report.geometry
    try:
        write_visual(file, align_splats(report.scene.splats, g.vertices[g.triangles], np.random.default_rng(0)).spec)
    except SceneError:
        return report
    return check_path(file)


def _start(name: str, pose: Pose, matrix: F64) -> dict[str, object]:
    at = matrix @ matrix_from_pose(pose)
    yaw = float(np.degrees(np.arctan2(at[1, 0], at[0, 0])))
    return {"name": name, "xyz": [round(float(c), 6) for c in at[:3, 3]], "yaw_deg": round(yaw, 4)}


def _objects(scene: SceneSpec, matrix: F64, textures: _Textures) -> Sequence[ImportedObject]:
    loader = MeshLoader(scene_roots(scene), textures="sizes")
    owners = assigned(scene)
    out = []
    for visual in scene.visuals:
        mesh = _mended(loader, visual.shape, matrix @ matrix_from_pose(visual.pose), textures)
        item = ImportedObject(visual.name, mesh, semantic_class=visual.semantic_class, color=visual.color, collision="none")
        own = owners.get(visual.name, [])
        if len(own) == 1 and own[0].shape == visual.shape and own[0].pose == visual.pose:
            item = replace(item, collision="same")
        elif len(own) > 1 and len({c.name for c in own}) == 1:
            # Several shapes of one name stand for a scan; they are made anew from the repaired mesh.
            item = replace(item, collision=SIMPLIFIED)
        elif own:
            meshes = [_mended(loader, c.shape, matrix @ matrix_from_pose(c.pose), None) for c in own]
            item = replace(item, collision=Mesh(tuple(part for m in meshes for part in m.parts)))
        if item.shape.parts:  # type: ignore[union-attr]
            out.append(item)
    for unseen in owners.get(UNSEEN, []):
        solid = _mended(loader, unseen.shape, matrix @ matrix_from_pose(unseen.pose), None)
        if solid.parts:
            out.append(ImportedObject(unseen.name, solid, visible=False))
    return out


def _mended(loader: MeshLoader, shape: Shape, matrix: F64, textures: _Textures | None) -> Mesh:
    """Returns a shape in the repaired scene, without degenerate or inverted triangles."""
    mesh = loader.shape(shape)
    vertices, triangles = mesh.merged()
    faults = find_faults(vertices, triangles)
    ends = np.cumsum([len(part.triangles) for part in mesh.parts])[:-1]
    parts = []
    for part, flat, inverted in zip(mesh.parts, np.split(faults.degenerate, ends), np.split(faults.inverted, ends), strict=True):
        turned = _turned(part, inverted)
        kept = some_triangles(turned, ~flat) if flat.any() else turned
        if not len(kept.triangles):
            continue
        plain = replace(kept, uvs=None, colors=None, material=Material()) if textures is None else kept
        parts.append(plain if textures is None else replace(plain, material=textures.material(plain.material, loader)))
    return Mesh(tuple(parts)).transformed(matrix)


def _turned(part: MeshPart, inverted: NDArray[np.bool_]) -> MeshPart:
    """Returns a part with the winding and the normals of some triangles inverted."""
    if not inverted.any():
        return part
    keep, turn = some_triangles(part, ~inverted), some_triangles(part, inverted)
    turn = replace(turn, normals=-turn.normals, triangles=np.ascontiguousarray(turn.triangles[:, ::-1]))

    return MeshPart(
        np.concatenate([keep.vertices, turn.vertices]),
        np.concatenate([keep.normals, turn.normals]),
        None if keep.uvs is None or turn.uvs is None else np.concatenate([keep.uvs, turn.uvs]),
        np.concatenate([keep.triangles, turn.triangles + np.uint32(len(keep.vertices))]),
        part.material,
        None if keep.colors is None or turn.colors is None else np.concatenate([keep.colors, turn.colors]),
    )


class _Textures:
    """Decodes the textures of materials one by one and scales them down to a limit."""

    def __init__(self, longest: int) -> None:
        self._longest = longest
        self._done: dict[int, TextureSource | None] = {}
        self._kept: list[TextureSource] = []

    def material(self, material: Material, loader: MeshLoader) -> Material:
        names = ("texture", "metallic_roughness_texture", "normal_texture", "occlusion_texture", "emissive_texture")
        changes = {name: self._image(getattr(material, name), loader) for name in names if getattr(material, name) is not None}
        return replace(material, **changes) if changes else material  # type: ignore[arg-type]

    def _image(self, texture: TextureSource, loader: MeshLoader) -> TextureSource | None:
        if id(texture) not in self._done:
            self._kept.append(texture)
            self._done[id(texture)] = self._read(texture, loader)
        return self._done[id(texture)]

    def _read(self, texture: TextureSource, loader: MeshLoader) -> TextureSource | None:
        rows, columns = texture.pixels.shape[:2]
        if rows * columns > MOST_PIXELS:
            raise SceneError(
                f"{texture.name}: has {columns} x {rows} pixels, too many even to make it smaller; use an image editor"
            )
        data = loader.image_bytes(texture)
        pixels = decode_image(data) if data else None
        if pixels is None:
            return None
        factor = self._longest / max(rows, columns)
        if factor < 1.0:
            size = (max(1, round(columns * factor)), max(1, round(rows * factor)))
            pixels = np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        return TextureSource(texture.name, pixels)
