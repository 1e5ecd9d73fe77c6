"""Assembles a building: one table of triangles with materials and atlas coordinates. NumPy only."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gibson_sim_tools.making.blender.casters import caster
from gibson_sim_tools.making.blender.charts import chart_extents, place_charts, place_corners
from gibson_sim_tools.making.blender.furniture.catalogue import build_piece
from gibson_sim_tools.making.blender.looks import UNTEXTURED
from gibson_sim_tools.making.blender.shapes import F64, I64, placed
from gibson_sim_tools.making.blender.shell import ShellObject, build_shell
from gibson_sim_tools.making.building import Building
from gibson_sim_tools.making.catalogue import CATALOGUE

NO_ATLAS = -1


@dataclass
class Assembly:
    """All triangles of a building."""

    names: list[str]
    classes: list[str]
    exported: list[bool]
    """Whether each object is in the scene."""
    patterns: list[str]
    """Pattern names."""
    corners: F64
    """(F, 3, 3): positions of the corners, world, metres."""
    owner: I64
    """(F,): index of the object."""
    pattern: I64
    """(F,): index of the pattern."""
    tint: F64
    """(F, 3): sRGB."""
    place: F64
    """(F, 3, 3): pattern coordinates."""
    atlas: I64
    """(F,): index of the atlas, or ``NO_ATLAS``."""
    uv: F64
    """(F, 3, 2): 0 to 1, from the lower left of the atlas."""
    boxes: F64
    """(B, 2, 3): low and high corners of the collision shapes, world."""
    box_owner: I64
    """(B,)."""
    charts: F64
    """(C, 5): index of the atlas, low corner and size of each chart, pixels."""
    density: float
    """Pixels per metre."""

    def save(self, path: Path) -> None:
        """Writes everything but the pattern coordinates, for a process without Blender."""
        np.savez_compressed(
            path, names=self.names, classes=self.classes, exported=self.exported, corners=self.corners.astype(np.float32),
            owner=self.owner, tint=self.tint.astype(np.float32), atlas=self.atlas, uv=self.uv.astype(np.float32),
            boxes=self.boxes, box_owner=self.box_owner, patterns=self.patterns, pattern=self.pattern, charts=self.charts,
        )  # fmt: skip


def things_of(building: Building) -> list[ShellObject]:
    """Returns the objects of shell and furniture, in world coordinates."""
    things = build_shell(building)
    for piece in building.pieces:
        solid = build_piece(piece.kind, piece.size, piece.seed, building.seed)
        matrix = placed(piece.position, piece.yaw)
        solid.turned(0, matrix)
        solid.boxes = [_turned_box(matrix, low, high) for low, high in solid.boxes]
        things.append(ShellObject(piece.name, CATALOGUE[piece.kind].semantic_class, solid))
    for body in building.bodies:
        shadow = caster(body)
        if shadow is not None:
            things.append(ShellObject(f"shadow_{body.name}", "", shadow, exported=False))
    return things


def _turned_box(matrix: F64, low: F64, high: F64) -> tuple[F64, F64]:
    """Returns the axis-aligned bounding box of a rotated box."""
    corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
    moved = corners @ matrix[:3, :3].T + matrix[:3, 3]
    return moved.min(axis=0), moved.max(axis=0)


def assemble(building: Building, atlases: int, size_px: int) -> Assembly:
    """Returns all triangles of a building, placed in its atlases."""
    things = things_of(building)
    rows: dict[str, list[NDArray[np.generic]]] = {
        k: [] for k in ("corners", "owner", "pattern", "tint", "place", "uv", "chart", "importance")
    }
    patterns: list[str] = []
    charts = 0
    for number, thing in enumerate(things):
        for part in thing.solid.parts:
            if part.surface.material not in patterns:
                patterns.append(part.surface.material)
            count = len(part.triangles)
            _, chart = np.unique(part.chart, return_inverse=True)
            rows["corners"].append(part.vertices[part.triangles])
            rows["owner"].append(np.full(count, number))
            rows["pattern"].append(np.full(count, patterns.index(part.surface.material)))
            rows["tint"].append(np.tile(part.surface.tint, (count, 1)))
            rows["place"].append(part.pattern)
            rows["uv"].append(part.uv)
            rows["chart"].append(np.asarray(chart).reshape(-1) + charts)
            rows["importance"].append(part.importance)
            charts += int(chart.max()) + 1
    table = {k: np.concatenate(v) for k, v in rows.items()}
    bare = [patterns.index(p) for p in (*UNTEXTURED, "outside") if p in patterns]
    hidden = np.array([not t.exported for t in things])[table["owner"]]
    textured = ~np.isin(table["pattern"], bare) & ~hidden
    atlas, uv, placed_charts, density = _place(table, textured, atlases, size_px)
    boxes = [(low, high) for t in things for low, high in t.solid.boxes]
    return Assembly(
        [t.name for t in things], [t.semantic_class for t in things], [t.exported for t in things], patterns,
        table["corners"], table["owner"], table["pattern"], table["tint"], table["place"], atlas, uv,
        np.array(boxes), np.array([k for k, t in enumerate(things) for _ in t.solid.boxes]), placed_charts, density,
    )  # fmt: skip


def _place(
    table: dict[str, NDArray[np.generic]], textured: NDArray[np.bool_], atlases: int, size_px: int
) -> tuple[I64, F64, F64, float]:
    chart = np.asarray(np.unique(table["chart"][textured], return_inverse=True)[1]).reshape(-1)
    count = int(chart.max()) + 1
    uv_m = np.asarray(table["uv"][textured], dtype=float)
    low, size = chart_extents(uv_m, chart, count)
    importance = np.zeros(count)
    np.maximum.at(importance, chart, np.asarray(table["importance"][textured], dtype=float))
    placement = place_charts(size, importance, atlases, size_px)
    atlas = np.full(len(textured), NO_ATLAS)
    atlas[textured] = placement.atlas[chart]
    uv = np.zeros((len(textured), 3, 2))
    uv[textured] = place_corners(uv_m, chart, low, size, placement, size_px)
    charts = np.column_stack([placement.atlas, placement.low_px, placement.size_px])
    return atlas, uv, charts, placement.density
