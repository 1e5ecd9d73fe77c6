"""Generates a scan-like indoor floor for renderer benchmarks: dense, uneven surfaces and one baked atlas.

Twelve furnished rooms on 14 x 10 m, 2.6 m high, connected by doors. The plan is fixed; the seed determines furniture, unevenness
and pictures; the number of triangles determines only the density. x east, y north, z up, the origin at the south-west corner.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise, product
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from gibson_sim.formats.mesh import Material, Mesh, MeshPart, TextureSource, area_normals
from gibson_sim.geometry.transforms import R_LINK_OPTICAL, Mat4
from gibson_sim.picture_files import write_picture
from gibson_sim.scenes.scene_yaml import write_scene_yaml
from gibson_sim_tools.generator import rooms_atlas, rooms_furniture
from gibson_sim_tools.generator.gltf import MeshBuilder, MeshMaterial, write_glb
from gibson_sim_tools.generator.rooms_atlas import AtlasFace
from gibson_sim_tools.generator.rooms_furniture import RoundedBox

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

COLUMNS = (0.0, 3.6, 7.1, 10.5, 14.0)
ROWS = (0.0, 3.3, 6.7, 10.0)
HEIGHT = 2.6
HALF_WALL = 0.06
DOOR_WIDTH = 1.0
DOOR_HEIGHT = 2.05
CAMERA_HEIGHT = 1.2
_WALL_EXTENSION = 0.03
"""Extension of walls below the uneven floor and above the uneven ceiling, m."""
_TOUR = ((0, 0), (1, 0), (2, 0), (3, 0), (3, 1), (3, 2), (2, 2), (2, 1), (1, 1), (1, 2), (0, 2), (0, 1))
"""Rooms, (column, row), in the order of the camera path."""
_EXTRA_DOORS = (((1, 0), (1, 1)), ((2, 1), (3, 1)), ((0, 1), (1, 1)))
_DOOR_OFFSETS = (0.3, -0.4, 0.1, 0.35, -0.2, -0.35, 0.25, 0.0, -0.3, 0.4, -0.1, 0.2, 0.5, -0.5, 0.4)
"""Offsets of doors from the centres of their walls, m."""
FURNITURE_DENSITY = 0.7
"""Ratio of the edge length of furniture triangles to that of the building's triangles."""
_WALL_COLORS = (
    (0.86, 0.82, 0.74),
    (0.70, 0.78, 0.82),
    (0.84, 0.74, 0.70),
    (0.76, 0.82, 0.70),
    (0.88, 0.86, 0.84),
    (0.80, 0.72, 0.56),
)
_FLOORS = (
    ("planks", (0.68, 0.50, 0.32)),
    ("tiles", (0.80, 0.79, 0.75)),
    ("planks", (0.46, 0.32, 0.22)),
    ("carpet", (0.45, 0.30, 0.28)),
)


@dataclass(frozen=True)
class Doorway:
    """An opening in the wall between two rooms."""

    rooms: tuple[tuple[int, int], tuple[int, int]]
    axis: int
    """Axis of passage: 0 = x."""
    at: float
    """Coordinate of the wall's centre along ``axis``, m."""
    middle: float
    """Coordinate of the door's centre along the wall, m."""

    def point(self, through: float) -> tuple[float, float]:
        """Returns the point ``through`` metres beyond the centre of the door, seen from its first room."""
        forward = 1.0 if sum(self.rooms[1]) > sum(self.rooms[0]) else -1.0
        along = self.at + forward * through
        return (along, self.middle) if self.axis == 0 else (self.middle, along)


def _doors() -> tuple[Doorway, ...]:
    pairs = [*zip(_TOUR, (*_TOUR[1:], _TOUR[0]), strict=True), *_EXTRA_DOORS]
    doors = []
    for (a, b), shift in zip(pairs, _DOOR_OFFSETS, strict=True):
        axis = 0 if a[0] != b[0] else 1
        lines, others = (COLUMNS, ROWS) if axis == 0 else (ROWS, COLUMNS)
        across = a[1 - axis]
        doors.append(Doorway((a, b), axis, lines[max(a[axis], b[axis])], (others[across] + others[across + 1]) / 2 + shift))
    return tuple(doors)


DOORS = _doors()


@dataclass(frozen=True)
class Sheet:
    """An uneven, nearly flat surface: a rectangle with at most one rectangular hole."""

    face: AtlasFace
    origin: F64
    """Corner with minimum u and v, (3,), m."""
    u: F64
    """Unit vector, (3,)."""
    v: F64
    """Unit vector, (3,); ``u x v`` is the normal."""
    breaks_u: tuple[float, ...]
    """Required vertex positions along u, m: both ends, and the sides of the hole."""
    breaks_v: tuple[float, ...]
    """Required vertex positions along v, m."""
    hole: tuple[float, float, float, float] | None = None
    """Rectangular hole, (u0, u1, v0, v1), m; None = no hole."""
    rough: float = 1.0
    """Factor of the unevenness; 0 = flat."""

    def triangles(self, step: float) -> int:
        """Returns the number of triangles with edges of about ``step`` metres."""
        if self.hole is None:
            return 2 * _cells(self.breaks_u, step) * _cells(self.breaks_v, step)
        u, v = _nodes(self.breaks_u, step), _nodes(self.breaks_v, step)
        return 2 * int(self._solid(u, v).sum())

    def _solid(self, u: F64, v: F64) -> NDArray[np.bool_]:
        solid = np.ones((len(u) - 1, len(v) - 1), dtype=bool)
        if self.hole is not None:
            u0, u1, v0, v1 = self.hole
            mid_u, mid_v = (u[1:] + u[:-1]) / 2, (v[1:] + v[:-1]) / 2
            solid &= ~(((mid_u > u0) & (mid_u < u1))[:, None] & ((mid_v > v0) & (mid_v < v1))[None, :])
        return solid

    def build(self, step: float, seed: int, rng: np.random.Generator) -> tuple[F64, F64, I64]:
        """Returns vertices (V, 3), m, coordinates on the face (V, 2), m, and triangles (F, 3)."""
        u, v = _nodes(self.breaks_u, step), _nodes(self.breaks_v, step)
        face_coords = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2)
        free = ~(np.isin(face_coords[:, 0], self.breaks_u) | np.isin(face_coords[:, 1], self.breaks_v))
        face_coords[free] += rng.uniform(-0.25, 0.25, (int(free.sum()), 2)) * step
        fade = np.clip(self._distance_to_edge(face_coords) / 0.2, 0.0, 1.0)
        flat = self.origin + face_coords[:, :1] * self.u + face_coords[:, 1:] * self.v
        uneven = 0.009 * wobble(flat, seed, 1.2) + 0.004 * wobble(flat, seed + 1, 0.35) + rng.uniform(-0.001, 0.001, len(flat))
        vertices = flat + (self.rough * fade * uneven)[:, None] * np.cross(self.u, self.v)
        triangles = _grid_triangles(len(u), len(v), rng)[np.repeat(self._solid(u, v).ravel(), 2)]
        used = np.unique(triangles)
        new_index = np.zeros(len(vertices), dtype=np.int64)
        new_index[used] = np.arange(len(used))
        return vertices[used], face_coords[used] - (self.breaks_u[0], self.breaks_v[0]), new_index[triangles]

    def _distance_to_edge(self, face_coords: F64) -> F64:
        low, high = (self.breaks_u[0], self.breaks_v[0]), (self.breaks_u[-1], self.breaks_v[-1])
        distance: F64 = np.minimum(face_coords - low, np.subtract(high, face_coords)).min(axis=1)
        if self.hole is not None:
            u0, u1, v0, v1 = self.hole
            gap = np.maximum(np.maximum((u0, v0) - face_coords, face_coords - (u1, v1)), 0.0)
            distance = np.minimum(distance, np.linalg.norm(gap, axis=1))
        return distance


@dataclass(frozen=True)
class BoxSide:
    """One of the six sides of a rounded box."""

    face: AtlasFace
    box: RoundedBox
    axis: int
    side: float
    """Sign of the side along ``axis``, -1 or 1."""

    def _counts(self, step: float) -> list[int]:
        fewest = 5 if self.box.radius > 0.05 else 1
        return [max(fewest, round(2 * h / (FURNITURE_DENSITY * step))) for h in self.box.half]

    def triangles(self, step: float) -> int:
        """Returns the number of triangles with edges of about ``step`` metres."""
        counts = self._counts(step)
        return 2 * counts[(self.axis + 1) % 3] * counts[(self.axis + 2) % 3]

    def build(self, step: float, seed: int, rng: np.random.Generator) -> tuple[F64, F64, I64]:
        """Returns vertices (V, 3), m, coordinates on the face (V, 2), m, and triangles (F, 3)."""
        a, b = (self.axis + 1) % 3, (self.axis + 2) % 3
        half, counts = np.array(self.box.half), self._counts(step)
        along = [np.linspace(-half[k], half[k], counts[k] + 1) for k in (a, b)]
        ga, gb = (g.ravel() for g in np.meshgrid(*along, indexing="ij"))
        p = np.empty((len(ga), 3))
        p[:, self.axis], p[:, a], p[:, b] = self.side * half[self.axis], ga, gb
        core = np.clip(p, -(half - self.box.radius), half - self.box.radius)
        normal = p - core
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        local = core + self.box.radius * normal
        # Vertices on an edge belong to two sides, so their displacement depends only on the position.
        height = 0.004 * min(1.0, float(half.min()) / 0.1)
        local = local + (height * wobble(local + self.box.center, seed + 2, 0.4))[:, None] * normal
        triangles = _grid_triangles(len(along[0]), len(along[1]), rng)
        face_coords = np.stack([ga + half[a], gb + half[b]], axis=1)
        return self.box.to_world(local), face_coords, triangles if self.side > 0 else triangles[:, ::-1]


ScannedSurface = Sheet | BoxSide


def _cells(breaks: tuple[float, ...], step: float) -> int:
    return sum(max(1, round((b - a) / step)) for a, b in pairwise(breaks))


def _nodes(breaks: tuple[float, ...], step: float) -> F64:
    pieces = [np.linspace(a, b, max(1, round((b - a) / step)) + 1)[:-1] for a, b in pairwise(breaks)]
    return np.concatenate([*pieces, breaks[-1:]])


def _grid_triangles(n_u: int, n_v: int, rng: np.random.Generator) -> I64:
    """Returns two counter-clockwise triangles per cell, (2 cells, 3), with random diagonals."""
    corner = (np.arange(n_u - 1)[:, None] * n_v + np.arange(n_v - 1)).ravel()
    a, b, c, d = corner, corner + n_v, corner + n_v + 1, corner + 1
    diagonal_ac = np.stack([a, b, c, a, c, d], axis=1)
    diagonal_bd = np.stack([a, b, d, b, c, d], axis=1)
    return np.where(rng.random(len(corner))[:, None] < 0.5, diagonal_ac, diagonal_bd).reshape(-1, 3)


def wobble(points: ArrayLike, seed: int, length: float) -> F64:
    """Returns smooth noise, (N,), about -1 to 1, at points (N, 3), m. ``length``: approximate wavelength, m."""
    rng = np.random.default_rng([seed, 77])
    waves = rng.normal(size=(6, 3))
    waves *= (2 * math.pi / length * rng.uniform(0.7, 1.4, 6) / np.linalg.norm(waves, axis=1))[:, None]
    total: F64 = np.sin(np.asarray(points, dtype=np.float64) @ waves.T + rng.uniform(0, 2 * math.pi, 6)).mean(axis=1) * 1.6
    return total


def _building(rng: np.random.Generator) -> Iterator[ScannedSurface]:
    for number, (column, row) in enumerate(product(range(len(COLUMNS) - 1), range(len(ROWS) - 1))):
        low, high = (COLUMNS[column], ROWS[row]), (COLUMNS[column + 1], ROWS[row + 1])
        size = (high[0] - low[0], high[1] - low[1])
        kind, tint = _FLOORS[number % len(_FLOORS)]
        across = ((0.0, size[0]), (0.0, size[1]))
        ex, ey = np.eye(3)[:2]
        yield Sheet(AtlasFace("floor", "floor", size, kind, tint), np.array([*low, 0.0]), ex, ey, *across)
        ceiling = AtlasFace("ceiling", "ceiling", (size[1], size[0]), "plaster", (0.92, 0.92, 0.9))
        yield Sheet(ceiling, np.array([*low, HEIGHT]), ey, ex, across[1], across[0])
        color = _WALL_COLORS[int(rng.integers(len(_WALL_COLORS)))]
        for axis, side in product((0, 1), (-1, 1)):
            yield _wall((column, row), axis, side, color)
    for door in DOORS:
        yield from _door_reveals(door)


def _wall(room: tuple[int, int], axis: int, side: int, color: tuple[float, float, float]) -> Sheet:
    """Returns the inner face of the wall that bounds a room along ``axis`` at its lower (-1) or upper (1) end."""
    lines, others = (COLUMNS, ROWS) if axis == 0 else (ROWS, COLUMNS)
    at = lines[room[axis] + (side > 0)] - side * HALF_WALL
    start, end = others[room[1 - axis]] + HALF_WALL, others[room[1 - axis] + 1] - HALF_WALL
    # Seen from inside, u runs to the right.
    u = np.zeros(3)
    u[1 - axis] = side * (-1.0 if axis == 0 else 1.0)
    first = start if u[1 - axis] > 0 else end
    origin = np.array([at, first, -_WALL_EXTENSION] if axis == 0 else [first, at, -_WALL_EXTENSION])
    length, height = end - start, HEIGHT + 2 * _WALL_EXTENSION
    neighbour = (room[0] + side, room[1]) if axis == 0 else (room[0], room[1] + side)
    door = next((d for d in DOORS if set(d.rooms) == {room, neighbour}), None)
    # All walls have vertices at door height, so that they join without cracks.
    top = DOOR_HEIGHT + _WALL_EXTENSION
    breaks_u: tuple[float, ...] = (0.0, length)
    hole = None
    if door is not None:
        middle = abs(door.middle - first)
        hole = (middle - DOOR_WIDTH / 2, middle + DOOR_WIDTH / 2, 0.0, top)
        breaks_u = (0.0, *hole[:2], length)
    face = AtlasFace("walls", "wall", (length, height), "wall" if door is not None else "decorated wall", color)
    return Sheet(face, origin, u, np.array([0.0, 0.0, 1.0]), breaks_u, (0.0, top, height), hole)


def _door_reveals(door: Doorway) -> Iterator[Sheet]:
    """Yields both sides and the top of a doorway."""
    white = (0.90, 0.89, 0.86)
    through, along, up = np.eye(3)[door.axis], np.eye(3)[1 - door.axis], np.eye(3)[2]
    depth_interval, top = (0.0, 2 * HALF_WALL), DOOR_HEIGHT + _WALL_EXTENSION
    for side in (-1.0, 1.0):
        base = along * (door.middle + side * DOOR_WIDTH / 2) - up * _WALL_EXTENSION
        # u x v must point into the doorway.
        forward = -side * float(np.linalg.det(np.stack([through, up, along])))
        origin = base + through * (door.at - forward * HALF_WALL)
        yield Sheet(
            AtlasFace("walls", "wall", (depth_interval[1], top), "plaster", white),
            origin,
            forward * through,
            up,
            depth_interval,
            (0.0, top),
            rough=0.0,
        )
    width_interval = (0.0, DOOR_WIDTH)
    origin = along * (door.middle - DOOR_WIDTH / 2) + up * DOOR_HEIGHT
    first, second = (along, through) if np.linalg.det(np.stack([along, through, up])) < 0 else (through, along)
    breaks = (width_interval, depth_interval) if first is along else (depth_interval, width_interval)
    face = AtlasFace("walls", "wall", (breaks[0][1], breaks[1][1]), "plaster", white)
    yield Sheet(face, origin + through * (door.at - HALF_WALL), first, second, *breaks, rough=0.0)


def _furniture(seed: int) -> Iterator[BoxSide]:
    rooms = [
        (COLUMNS[c] + HALF_WALL, ROWS[r] + HALF_WALL, COLUMNS[c + 1] - HALF_WALL, ROWS[r + 1] - HALF_WALL)
        for c, r in sorted(_TOUR)
    ]
    gaps = [(d.axis, d.at, d.middle) for d in DOORS]
    path = _path()
    for piece in rooms_furniture.furnish(rooms, gaps, path, np.random.default_rng([seed, 5])):
        for box in piece.boxes:
            for axis, side in product(range(3), (-1.0, 1.0)):
                a, b = (axis + 1) % 3, (axis + 2) % 3
                face = AtlasFace(piece.name, piece.semantic_class, (2 * box.half[a], 2 * box.half[b]), box.pattern, box.color)
                yield BoxSide(face, box, axis, side)


def rooms_parts(triangles: int, seed: int = 0, atlas: int = 4096) -> dict[str, tuple[str, MeshPart]]:
    """Returns semantic class and mesh of every object by name: floor, walls, ceiling, and each piece of furniture.

    Args:
        triangles: number of triangles of all parts together, met within 3 percent.
        seed: seed of furniture, unevenness and pictures.
        atlas: width and height of the texture shared by all parts, pixels.
    """
    rng = np.random.default_rng([seed, 3])
    surfaces: list[ScannedSurface] = [*_building(rng), *_furniture(seed)]
    step = _edge_length_for(surfaces, triangles)
    places = rooms_atlas.pack([s.face.size for s in surfaces], atlas)
    pixels = rooms_atlas.paint([s.face for s in surfaces], places, seed)
    material = Material("rooms", (1.0, 1.0, 1.0, 1.0), TextureSource("rooms atlas", pixels), unlit=True)
    by_object: dict[str, tuple[str, list[F64], list[F64], list[I64]]] = {}
    for index, (surface, place) in enumerate(zip(surfaces, places.rects, strict=True)):
        vertices, face_coords, faces = surface.build(step, seed, np.random.default_rng([seed, 9, index]))
        _, points, uvs, indices = by_object.setdefault(surface.face.name, (surface.face.semantic_class, [], [], []))
        indices.append(faces + sum(map(len, points)))
        points.append(vertices)
        # Row 0 of the picture is the top of a wall.
        u, v = face_coords[:, 0], surface.face.size[1] - face_coords[:, 1]
        uvs.append(np.stack([place[0] + u * places.px_per_m, place[1] + v * places.px_per_m], axis=1) / atlas)
    return {
        name: (kind, _part(np.concatenate(points), np.concatenate(uvs), np.concatenate(indices), material))
        for name, (kind, points, uvs, indices) in by_object.items()
    }


def _part(vertices: F64, uvs: F64, triangles: I64, material: Material) -> MeshPart:
    normals = area_normals(vertices, triangles).astype(np.float32)
    return MeshPart(vertices.astype(np.float32), normals, uvs.astype(np.float32), triangles.astype(np.uint32), material)


def _edge_length_for(surfaces: list[ScannedSurface], triangles: int) -> float:
    """Returns the edge length, m, that gives about this number of triangles."""
    low, high = 0.002, 3.0
    for _ in range(30):
        step = math.sqrt(low * high)
        if sum(s.triangles(step) for s in surfaces) > triangles:
            low = step
        else:
            high = step
    return high


def rooms_mesh(triangles: int, seed: int = 0, atlas: int = 4096) -> Mesh:
    """Returns all rooms as one part with one unlit material; see ``rooms_parts``."""
    return merged(rooms_parts(triangles, seed, atlas))


def merged(parts: dict[str, tuple[str, MeshPart]]) -> Mesh:
    """Merges parts with the same material into a mesh of one part."""
    mesh_parts = [part for _, part in parts.values()]
    starts = np.cumsum([0, *(len(p.vertices) for p in mesh_parts)])
    triangles = np.concatenate([p.triangles + np.uint32(start) for p, start in zip(mesh_parts, starts, strict=False)])
    uvs = np.concatenate([p.uvs for p in mesh_parts if p.uvs is not None])
    vertices, normals = np.concatenate([p.vertices for p in mesh_parts]), np.concatenate([p.normals for p in mesh_parts])
    return Mesh((MeshPart(vertices, normals, uvs, triangles, replace(mesh_parts[0].material)),))


def _path() -> F64:
    """Returns the closed camera path through all rooms, (M, 2), m."""
    corners: list[tuple[float, float]] = []
    doors = DOORS[: len(_TOUR)]
    for number, (column, row) in enumerate(_TOUR):
        corners.append(doors[number - 1].point(0.6))
        corners.append(((COLUMNS[column] + COLUMNS[column + 1]) / 2, (ROWS[row] + ROWS[row + 1]) / 2))
        corners += [doors[number].point(-0.6), doors[number].point(0.0)]
    points = np.array(corners)
    for _ in range(4):
        # Chaikin's corner cutting; the path stays inside its corners, clear of the walls.
        following = np.roll(points, -1, axis=0)
        points = np.stack([0.75 * points + 0.25 * following, 0.25 * points + 0.75 * following], axis=1).reshape(-1, 2)
    return points


def rooms_camera_path(n: int) -> list[Mat4]:
    """Returns ``n`` poses T_world_camera (optical frame) on a closed drive through all rooms, 1.2 m high, evenly spaced.

    The camera looks ahead along the path, with an oscillating yaw and pitch.
    """
    points = _path()
    points = np.concatenate([points, points[:1]])
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    at = np.arange(n) / n * arc[-1]

    def position(arc_length: F64) -> F64:
        inside = np.mod(arc_length, arc[-1])
        return np.stack([np.interp(inside, arc, points[:, k]) for k in range(2)], axis=1)

    ahead = position(at + 0.3) - position(at - 0.3)
    phase = 2 * math.pi * np.arange(n) / n
    yaw = np.arctan2(ahead[:, 1], ahead[:, 0]) + math.radians(40.0) * np.sin(17 * phase)
    pitch = math.radians(8.0) * np.sin(11 * phase + 0.5)
    poses = []
    for (x, y), angle, nod in zip(position(at), yaw, pitch, strict=True):
        cy, sy, cp, sp = math.cos(angle), math.sin(angle), math.cos(nod), math.sin(nod)
        R_world_link = np.array([[cy * cp, -sy, cy * sp], [sy * cp, cy, sy * sp], [-sp, 0.0, cp]])
        pose = np.eye(4)
        pose[:3, :3] = R_world_link @ R_LINK_OPTICAL
        pose[:3, 3] = (x, y, CAMERA_HEIGHT)
        poses.append(pose)
    return poses


def make_rooms(folder: Path, seed: int = 0, triangles: int = 100_000, atlas: int = 4096) -> None:
    """Writes scene.yaml with separate objects, rooms.glb with all of them, and their atlas."""
    (folder / "parts").mkdir(parents=True, exist_ok=True)
    parts = rooms_parts(triangles, seed, atlas)
    texture = next(iter(parts.values()))[1].material.texture
    assert texture is not None
    write_picture(folder / "atlas.jpg", cv2.cvtColor(texture.pixels, cv2.COLOR_RGB2BGR), (cv2.IMWRITE_JPEG_QUALITY, 92))
    _write(folder / "rooms.glb", merged(parts).parts[0], "atlas.jpg")
    objects = []
    for name, (semantic_class, part) in parts.items():
        _write(folder / "parts" / f"{name}.glb", part, "../atlas.jpg")
        objects.append({"name": name, "mesh": f"parts/{name}.glb", "semantic_class": semantic_class})
    scene = {
        "name": f"rooms_{triangles}",
        "description": f"Twelve rooms like a scan, {triangles} triangles, made by gibson_sim_tools.generator",
        "floor_z": 0.0,
        "starts": [{"name": "south_west", "xy": [1.8, 1.65], "yaw_deg": 0.0}],
        "objects": objects,
    }
    write_scene_yaml(folder, scene, width=None)


def _write(path: Path, part: MeshPart, texture: str) -> None:
    solid = MeshBuilder()
    assert part.uvs is not None
    solid.add(MeshMaterial("rooms", texture, unlit=True), part.vertices, part.normals, part.uvs, part.triangles)
    write_glb(path, solid)
