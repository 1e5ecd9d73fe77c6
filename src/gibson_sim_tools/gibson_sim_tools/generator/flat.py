"""Generates the scene ``flat``: a hall with a living room, a kitchen, a bedroom and a bathroom.

Metres, x east, y north, z up, the origin at the south-west corner. Walls are 0.12 m thick and centred on the lines of the
plan.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np

from gibson_sim.picture_files import write_picture
from gibson_sim.scenes.scene_yaml import write_scene_yaml
from gibson_sim.writing import write_file
from gibson_sim_tools.generator import furniture, textures
from gibson_sim_tools.generator.gltf import MeshBuilder, MeshMaterial, write_glb

HEIGHT = 2.6
THICKNESS = 0.12
DOOR_HEIGHT = 2.05
PX_PER_M = 150
LICENSE = """\
This scene was made by gibson_sim_tools.generator, part of Gibson Sim, and is released under the Apache License, Version 2.0.
"""


@dataclass(frozen=True)
class FlatRoom:
    """A rectangular room between the centre lines of its walls."""

    name: str
    x0: float
    y0: float
    x1: float
    y1: float
    wall: textures.Rgb
    floor: str
    """Floor covering: planks or tiles."""

    def contains(self, x: float, y: float) -> bool:
        """Returns whether a point, m, is in the room."""
        return self.x0 <= x <= self.x1 and self.y0 <= y <= self.y1


ROOMS = (
    FlatRoom("living", 0.0, 0.0, 5.2, 4.0, (0.90, 0.86, 0.78), "planks"),
    FlatRoom("kitchen", 5.2, 0.0, 9.0, 4.0, (0.80, 0.86, 0.82), "tiles"),
    FlatRoom("hall", 0.0, 4.0, 9.0, 5.4, (0.88, 0.84, 0.84), "planks"),
    FlatRoom("bedroom", 0.0, 5.4, 5.4, 8.6, (0.74, 0.80, 0.88), "planks"),
    FlatRoom("bathroom", 5.4, 5.4, 9.0, 8.6, (0.72, 0.86, 0.88), "tiles"),
)


_CLASSES = {"living": "living_room"}
"""Room classes that differ from the room's name."""


@dataclass(frozen=True)
class FlatOpening:
    """An opening in a wall, from ``start`` to ``end`` along it, m."""

    start: float
    end: float
    low: float = 0.0
    high: float = DOOR_HEIGHT

    @property
    def is_window(self) -> bool:
        """Whether the opening is a window: it does not reach the floor."""
        return self.low > 0.0


def _window(start: float, end: float, low: float = 0.85, high: float = 2.1) -> FlatOpening:
    return FlatOpening(start, end, low, high)


@dataclass(frozen=True)
class FlatWall:
    """A wall along x (``at`` is its y) or along y (``at`` is its x), from ``start`` to ``end``, m."""

    along: str
    at: float
    start: float
    end: float
    openings: tuple[FlatOpening, ...] = ()

    def point(self, along: float, across: float, z: float) -> tuple[float, float, float]:
        """Returns the point at a position along the wall, a distance from its centre line, and a height, m."""
        return (along, self.at + across, z) if self.along == "x" else (self.at + across, along, z)


WALLS = (
    FlatWall("x", 0.0, 0.0, 9.0, (_window(0.7, 2.3), _window(2.9, 4.5), _window(6.5, 8.1, 1.05))),
    FlatWall("x", 4.0, 0.0, 9.0, (FlatOpening(3.6, 4.5), FlatOpening(6.0, 6.9))),
    FlatWall("x", 5.4, 0.0, 9.0, (FlatOpening(2.0, 2.9), FlatOpening(7.0, 7.9))),
    FlatWall("x", 8.6, 0.0, 9.0, (_window(1.6, 3.6), _window(6.9, 7.7, 1.4))),
    FlatWall("y", 0.0, 0.0, 8.6, (_window(1.2, 2.8), _window(6.2, 7.6))),
    FlatWall("y", 9.0, 0.0, 8.6, (_window(1.0, 2.4, 1.05),)),
    FlatWall("y", 5.2, 0.0, 4.0, (FlatOpening(1.1, 2.3),)),
    FlatWall("y", 5.4, 5.4, 8.6),
)
STARTS = (
    ("hall", 1.0, 4.7, 0.0),
    ("living", 4.4, 2.9, 180.0),
    ("kitchen", 6.4, 3.3, -70.0),
    ("bedroom", 2.45, 6.1, 60.0),
    ("bathroom", 7.4, 6.2, 90.0),
)


@dataclass
class _Flat:
    """Writes the files of the flat and lists its objects."""

    folder: Path
    seed: int
    objects: list[dict[str, object]] = field(default_factory=list)

    def rng(self, name: str) -> np.random.Generator:
        """Returns a separate random generator for each texture, so that a new texture does not change the others."""
        return np.random.default_rng([self.seed, *name.encode()])

    def texture(self, name: str, image: textures.Image, quality: int = 88) -> str:
        """Writes a texture; returns its path relative to ``assets``."""
        path = self.folder / "assets" / "textures" / f"{name}.jpg"
        write_picture(path, image[..., ::-1], (cv2.IMWRITE_JPEG_QUALITY, quality), durable=False)
        return f"textures/{name}.jpg"

    def add(
        self,
        name: str,
        solid: MeshBuilder,
        semantic_class: str,
        *,
        collision: str = "same",
        xy: tuple[float, float] = (0.0, 0.0),
        yaw_deg: float = 0.0,
    ) -> None:
        """Writes a mesh and adds an object for it."""
        write_glb(self.folder / "assets" / f"{name}.glb", solid)
        self.place(name, name, semantic_class, collision=collision, xy=xy, yaw_deg=yaw_deg)

    def place(
        self,
        name: str,
        mesh: str,
        semantic_class: str,
        *,
        collision: str = "same",
        xy: tuple[float, float] = (0.0, 0.0),
        yaw_deg: float = 0.0,
    ) -> None:
        """Adds an object with an existing mesh."""
        item: dict[str, object] = {
            "name": name,
            "mesh": f"assets/{mesh}.glb",
            "semantic_class": semantic_class,
            "collision": collision,
        }
        if xy != (0.0, 0.0) or yaw_deg:
            item["pose"] = {"xyz": [xy[0], xy[1], 0.0], "rpy_deg": [0.0, 0.0, yaw_deg]}
        self.objects.append(item)


def make_flat(folder: Path, seed: int = 1) -> None:
    """Writes the flat: scene.yaml, assets, LICENSE."""
    (folder / "assets" / "textures").mkdir(parents=True, exist_ok=True)
    flat = _Flat(folder, seed)
    pieces = furniture.furnish(flat.texture, flat.rng)
    for piece in pieces:
        if piece.solid is not None:
            flat.add(piece.name, piece.solid, piece.semantic_class, xy=piece.xy, yaw_deg=piece.yaw_deg, collision=piece.collision)
        else:
            flat.place(
                piece.name, piece.mesh, piece.semantic_class, xy=piece.xy, yaw_deg=piece.yaw_deg, collision=piece.collision
            )
    _add_walls(flat)
    _add_floors(flat, [p.footprint for p in pieces if p.footprint])
    _add_frames(flat)
    description = {
        "name": "flat",
        "description": "A flat of five rooms, 9 x 8.6 m, made by gibson_sim_tools.generator",
        "ground_z": 0.0,
        "floor_z": 0.0,
        "rooms": [
            {
                "name": r.name,
                "class": _CLASSES.get(r.name, r.name),
                "polygon": [[r.x0, r.y0], [r.x1, r.y0], [r.x1, r.y1], [r.x0, r.y1]],
            }
            for r in ROOMS
        ],
        "light": {"sun_direction": [0.45, 0.6, -0.66], "sun": 0.5, "ambient": 0.62, "background": [0.75, 0.84, 0.93]},
        "starts": [{"name": n, "xy": [x, y], "yaw_deg": yaw} for n, x, y, yaw in STARTS],
        "objects": flat.objects,
    }
    write_scene_yaml(folder, description, f"Made by: python -m gibson_sim_tools.generator flat DIR --seed {seed}", width=130)
    write_file(folder / "LICENSE", LICENSE)


def _add_walls(flat: _Flat) -> None:
    """Adds walls, in pieces around their openings; each side has the colour of its room."""
    materials = {
        room.name: MeshMaterial(
            f"wall_{room.name}", flat.texture(f"wall_{room.name}", textures.wall(flat.rng(room.name), room.wall)), metres=HEIGHT
        )
        for room in ROOMS
    }
    outside = MeshMaterial("facade", color=(0.8, 0.78, 0.74))
    solid = MeshBuilder()
    half = THICKNESS / 2
    for wall in WALLS:
        # Adjacent walls overlap, so that corners are closed.
        edges = [(wall.start - half, 0.0)]
        pieces: list[tuple[float, float, float, float]] = []
        position = edges[0][0]
        for hole in wall.openings:
            pieces.append((position, hole.start, 0.0, HEIGHT))
            pieces.append((hole.start, hole.end, hole.high, HEIGHT))
            if hole.low > 0.0:
                pieces.append((hole.start, hole.end, 0.0, hole.low))
            position = hole.end
        pieces.append((position, wall.end + half, 0.0, HEIGHT))
        for start, end, low, high in pieces:
            _wall_piece(solid, wall, (start, end, low, high), materials, outside)
    flat.add("walls", solid, "wall")


def _wall_piece(
    solid: MeshBuilder,
    wall: FlatWall,
    extent: tuple[float, float, float, float],
    materials: dict[str, MeshMaterial],
    outside: MeshMaterial,
) -> None:
    """Adds one box of a wall. Its sides are split where the adjacent room changes; the texture spans the room height."""
    start, end, low, high = extent
    half = THICKNESS / 2
    splits = sorted(
        {start, end, *(c for r in ROOMS for c in ((r.x0, r.x1) if wall.along == "x" else (r.y0, r.y1)) if start < c < end)}
    )
    for side in (-1.0, 1.0):
        for a, b in pairwise(splits):
            x, y, _ = wall.point((a + b) / 2, side * (half + 0.05), 0.0)
            material = next((materials[r.name] for r in ROOMS if r.contains(x, y)), outside)
            # Seen from its room, a wall along x runs to the right on its south side, to the left on its north side.
            flip = (side > 0) == (wall.along == "x")
            p, q = (b, a) if flip else (a, b)
            corners = [wall.point(s, side * half, z) for s, z in ((p, low), (q, low), (q, high), (p, high))]
            uvs = [(s / HEIGHT, 1.0 - z / HEIGHT) for s, z in ((p, low), (q, low), (q, high), (p, high))]
            solid.quad(material, corners, uvs)
    jamb = MeshMaterial("jamb", color=(0.86, 0.85, 0.82))
    ends = [wall.point(s, c, z) for s in (start, end) for c in (-half, half) for z in (low, high)]
    corners_low, corners_high = np.min(ends, axis=0), np.max(ends, axis=0)
    sides = ("-y", "+y") if wall.along == "x" else ("-x", "+x")
    solid.box(corners_low, corners_high, jamb, omit=sides)


def _add_floors(flat: _Flat, footprints: Sequence[tuple[float, float, float, float]]) -> None:
    """Adds a floor and a ceiling for each room; each floor has its own texture, shaded along walls and under furniture."""
    floors, ceilings = MeshBuilder(), MeshBuilder()
    white = MeshMaterial("ceiling", flat.texture("ceiling", textures.ceiling()))
    for room in ROOMS:
        size = (room.x1 - room.x0, room.y1 - room.y0)
        rng = flat.rng(f"floor_{room.name}")
        if room.floor == "planks":
            base = textures.planks(rng, size, PX_PER_M, (0.66, 0.46, 0.28) if room.name != "bedroom" else (0.58, 0.42, 0.30))
        else:
            base = textures.tiles(rng, size, PX_PER_M, (0.85, 0.83, 0.78) if room.name == "kitchen" else (0.62, 0.70, 0.74))
        inside = [(a - room.x0, b - room.y0, c - room.x0, d - room.y0) for a, b, c, d in footprints]
        material = MeshMaterial(
            f"floor_{room.name}", flat.texture(f"floor_{room.name}", textures.shaded_floor(base, PX_PER_M, inside))
        )
        x0, y0, x1, y1 = room.x0, room.y0, room.x1, room.y1
        full_uvs = [(0, 1), (1, 1), (1, 0), (0, 0)]
        floors.quad(material, [(x0, y0, 0), (x1, y0, 0), (x1, y1, 0), (x0, y1, 0)], full_uvs)
        ceilings.quad(white, [(x0, y1, HEIGHT), (x1, y1, HEIGHT), (x1, y0, HEIGHT), (x0, y0, HEIGHT)], full_uvs)
    flat.add("floors", floors, "floor", collision="none")
    flat.add("ceilings", ceilings, "ceiling", collision="none")


def _add_frames(flat: _Flat) -> None:
    """Adds door frames, windows with the view outside, and skirting boards."""
    frames, windows, skirting = MeshBuilder(), MeshBuilder(), MeshBuilder()
    white = MeshMaterial("frame", color=(0.83, 0.82, 0.79))
    view = MeshMaterial("view", flat.texture("view", textures.view_outside(flat.rng("view"))), unlit=True)
    board = MeshMaterial("skirting", color=(0.8, 0.78, 0.74))
    half = THICKNESS / 2
    for wall in WALLS:
        for hole in wall.openings:
            if hole.is_window:
                _window_parts(windows, wall, hole, white, view)
            else:
                _door_frame(frames, wall, hole, white)
        for side in (-1.0, 1.0):
            _skirting(skirting, wall, side, board, half)
    flat.add("door_frames", frames, "door_frame")
    flat.add("windows", windows, "window")
    flat.add("skirting", skirting, "skirting", collision="none")
    door = MeshBuilder()
    oak = MeshMaterial("entrance", "textures/oak.jpg", metres=1.0)
    door.box((8.88, 4.3, 0.0), (8.94, 5.2, 2.05), oak)
    door.cylinder((8.86, 4.42, 1.02), 0.02, 0.1, MeshMaterial("handle", color=(0.35, 0.33, 0.3)))
    flat.add("entrance_door", door, "door")


def _box_corners(
    wall: FlatWall, along: tuple[float, float], across: tuple[float, float], z: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Returns the lower and upper corner of a box given by intervals along a wall, across it, and in height, m."""
    a, b = wall.point(along[0], across[0], z[0]), wall.point(along[1], across[1], z[1])
    return np.minimum(a, b), np.maximum(a, b)


def _door_frame(solid: MeshBuilder, wall: FlatWall, hole: FlatOpening, material: MeshMaterial) -> None:
    half_depth, width = THICKNESS / 2 + 0.015, 0.06
    for start in (hole.start - width + 0.01, hole.end - 0.01):
        solid.box(*_box_corners(wall, (start, start + width), (-half_depth, half_depth), (0.0, hole.high + width)), material)
    solid.box(
        *_box_corners(wall, (hole.start, hole.end), (-half_depth, half_depth), (hole.high - 0.01, hole.high + width)), material
    )


def _window_parts(solid: MeshBuilder, wall: FlatWall, hole: FlatOpening, material: MeshMaterial, view: MeshMaterial) -> None:
    half_depth, bar = 0.03, 0.05
    for start in (hole.start, hole.end - bar, (hole.start + hole.end - bar) / 2):
        solid.box(*_box_corners(wall, (start, start + bar), (-half_depth, half_depth), (hole.low, hole.high)), material)
    for low in (hole.low, hole.high - bar):
        solid.box(*_box_corners(wall, (hole.start, hole.end), (-half_depth, half_depth), (low, low + bar)), material)
    sill = 0.12 if wall.at in (0.0,) else -0.12
    solid.box(*_box_corners(wall, (hole.start - 0.05, hole.end + 0.05), (0.0, sill), (hole.low - 0.03, hole.low)), material)
    inward = 1.0 if wall.at == 0.0 else -1.0
    # Seen from inside, the picture runs from left to right.
    flip = (inward > 0) == (wall.along == "x")
    p, q = (hole.end, hole.start) if flip else (hole.start, hole.end)
    corners = [wall.point(s, 0.0, z) for s, z in ((p, hole.low), (q, hole.low), (q, hole.high), (p, hole.high))]
    solid.quad(view, corners, [(0, 1), (1, 1), (1, 0), (0, 0)])


def _skirting(solid: MeshBuilder, wall: FlatWall, side: float, material: MeshMaterial, half: float) -> None:
    """Adds 8 cm skirting along one side of a wall, between its doors, inside the flat."""
    x, y, _ = wall.point((wall.start + wall.end) / 2, side * (half + 0.05), 0.0)
    if not any(r.contains(x, y) for r in ROOMS):
        return
    at = wall.start
    for hole in [*(h for h in wall.openings if not h.is_window), None]:
        end = wall.end if hole is None else hole.start - 0.05
        solid.box(*_box_corners(wall, (at, end), (side * half, side * (half + 0.014)), (0.0, 0.08)), material)
        if hole is not None:
            at = hole.end + 0.05
