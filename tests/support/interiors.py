"""Rooms as triangles, and folders in the layouts of public data sets, for tests of importers and checks."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from support.plys import ply

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
SIZE = (6.0, 4.0, 2.5)
"""Of the room, metres; the middle of its floor is the origin."""
_SIDES = [(0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]


def box_faces(low: ArrayLike, high: ArrayLike, *, inward: bool = False) -> tuple[F64, I64]:
    """Returns corners (8, 3) and quads (6, 4) of a box, seen from outside or, as a room, from inside."""
    (x0, y0, z0), (x1, y1, z1) = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
    corners = np.array([(x, y, z) for z in (z0, z1) for x, y in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))])
    quads = np.array(_SIDES)
    return corners, quads[:, ::-1] if inward else quads


def room(*, furniture: bool = True) -> tuple[F64, I64]:
    """Returns corners and quads of a room of ``SIZE`` that is seen from inside, with a box of 1 m at 2, 1."""
    x, y, z = SIZE
    corners, quads = box_faces((-x / 2, -y / 2, 0.0), (x / 2, y / 2, z), inward=True)
    if not furniture:
        return corners, quads
    more, sides = box_faces((1.5, 0.5, 0.0), (2.5, 1.5, 1.0))
    return np.concatenate([corners, more]), np.concatenate([quads, sides + len(corners)])


def triangles(quads: I64) -> I64:
    """Returns (2 F, 3)."""
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def turned(points: F64, axis: int, degrees: float) -> F64:
    """Returns points turned about an axis."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    a, b = (axis + 1) % 3, (axis + 2) % 3
    rotation = np.eye(3)
    rotation[[a, a, b, b], [a, b, a, b]] = c, -s, s, c
    return points @ rotation.T


def write_obj(path: Path, corners: F64, faces: I64, texture: str = "") -> Path:
    """Writes an OBJ; with a texture, an MTL that names it."""
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in corners.tolist()]
    if texture:
        path.with_suffix(".mtl").write_text(f"newmtl scan\nmap_Kd {texture}\n")
        lines = [f"mtllib {path.stem}.mtl", *lines, "vt 0 0", "vt 1 0", "vt 1 1", "vt 0 1", "usemtl scan"]
    for face in (faces + 1).tolist():
        lines.append("f " + " ".join(f"{v}/{k + 1}" if texture else str(v) for k, v in enumerate(face)))
    path.write_text("\n".join(lines) + "\n")
    return path


def write_gibson_folder(folder: Path, *, floors: tuple[float, ...] = (0.0,)) -> Path:
    """Writes a scene in Gibson's layout: a textured mesh, heights of floors, and a map of each."""
    folder.mkdir(parents=True)
    corners, quads = room()
    write_obj(folder / "mesh_z_up.obj", corners, quads, "atlas.png")
    write_obj(folder / "mesh_z_up_downsampled.obj", *room(furniture=False))
    cv2.imwrite(str(folder / "atlas.png"), np.full((64, 64, 3), (60, 120, 180), dtype=np.uint8))
    (folder / "floors.txt").write_text("".join(f"{z}\n" for z in floors))
    # 0.01 m a pixel, the origin in the middle, the first row at the lowest y: free where x > 0 and y > 0.
    picture = np.zeros((800, 800), dtype=np.uint8)
    picture[400:600, 400:700] = 255
    for number in range(len(floors)):
        cv2.imwrite(str(folder / f"floor_trav_{number}.png"), picture)
    return folder


def write_replica_folder(folder: Path) -> Path:
    """Writes a scene in Replica's layout: quads with colours, and labels of objects: the room is 3, the box 7."""
    (folder / "habitat").mkdir(parents=True)
    corners, quads = room()
    colors = np.full((len(corners), 3), (200, 150, 100))
    objects = [3] * 6 + [7] * 6
    (folder / "mesh.ply").write_bytes(ply(corners, quads.tolist(), colors))
    (folder / "habitat" / "mesh_semantic.ply").write_bytes(ply(corners, quads.tolist(), colors, objects=objects))
    classes = [{"id": 3, "class_name": "wall"}, {"id": 7, "class_name": "Night Stand"}]
    (folder / "habitat" / "info_semantic.json").write_text(json.dumps({"objects": classes}))
    return folder
