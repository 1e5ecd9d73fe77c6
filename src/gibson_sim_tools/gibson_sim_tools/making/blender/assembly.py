"""Assembles a building: a table of triangles with patterns and coordinates in the light maps. NumPy only.

Boxes that are not part of the scene cast the shadows of large movable bodies in the bake.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gibson_sim_tools.making.blender.appearances import UNLIT
from gibson_sim_tools.making.blender.charts import chart_extents, place_charts, place_corners
from gibson_sim_tools.making.blender.furniture import build_piece
from gibson_sim_tools.making.blender.shapes import F64, I64, ObjectBuilder, Surface, pose_matrix
from gibson_sim_tools.making.blender.shell import ShellObject, build_shell
from gibson_sim_tools.making.building import Body, Building
from gibson_sim_tools.making.catalogue import CATALOGUE

NO_ATLAS = -1
_LARGE_CHART_M, _SMALL_CHART_FACTOR = 0.6, 1.5
"""Longest side from which a chart has the usual texel density, m, and the factor of the density of the smallest charts."""
_Box = tuple[tuple[float, float, float], tuple[float, float, float]]
_CASTERS: dict[str, tuple[_Box, ...]] = {
    "fridge_body": (((-0.34, -0.3, 0.02), (0.31, 0.3, 1.78)),),
    "oven_body": (((-0.3, -0.297, 0.02), (0.27, 0.297, 0.6)),),
    "cabinet_drawers": (((-0.22, -0.3, 0.03), (0.2, 0.3, 0.72)),),
    "cabinet_doors": (((-0.22, -0.4, 0.03), (0.2, 0.4, 0.76)),),
    "chair_wooden": (((-0.2, -0.2, 0.435), (0.22, 0.2, 0.455)), ((-0.24, -0.19, 0.7), (-0.22, 0.19, 0.85))),
    "stool": (((-0.17, -0.17, 0.43), (0.17, 0.17, 0.46)),),
    "table_side": (((-0.21, -0.21, 0.47), (0.21, 0.21, 0.5)),),
    "box_cardboard": (((-0.145, -0.195, 0.0), (0.145, 0.195, 0.28)),),
    "basket": (((-0.12, -0.17, 0.0), (0.12, 0.17, 0.22)),),
    "bin_waste": (((-0.1, -0.1, 0.0), (0.1, 0.1, 0.32)),),
    "ball": (((-0.06, -0.06, 0.02), (0.06, 0.06, 0.2)),),
}
"""Lower and upper corners of the boxes for models of ``scenes/objects``, m."""


@dataclass
class Assembly:
    """All triangles of a building."""

    names: list[str]
    """Name of each object."""
    classes: list[str]
    """Semantic class of each object."""
    exported: list[bool]
    """Whether each object is part of the scene."""
    patterns: list[str]
    """Names of the patterns."""
    corners: F64
    """Corners of the triangles, (F, 3, 3), m, world frame."""
    owner: I64
    """Index of the object of each triangle, (F,)."""
    pattern: I64
    """Index of the pattern of each triangle, (F,)."""
    tint: F64
    """Colour of each triangle, (F, 3), sRGB."""
    pattern_coords: F64
    """Pattern coordinates of the corners, m, and the number of a single picture, (F, 3, 3)."""
    thin: NDArray[np.bool_]
    """Whether each triangle is part of a sheet, (F,)."""
    atlas: I64
    """Index of the light map of each triangle, or ``NO_ATLAS``, (F,)."""
    uv: F64
    """Coordinates of the corners in the light map, (F, 3, 2), 0 to 1 from the lower left."""
    boxes: F64
    """Lower and upper corners of the collision boxes, (B, 2, 3), m, world frame."""
    box_owner: I64
    """Index of the object of each collision box, (B,)."""
    charts: I64
    """Index of the light map, column and row of the lower left texel, columns and rows of each chart, (C, 5)."""
    density: float
    """Density of the light maps, texels per metre."""

    def save(self, path: Path) -> None:
        """Writes everything, for a process without Blender."""
        np.savez_compressed(
            path, names=self.names, classes=self.classes, exported=self.exported, corners=self.corners.astype(np.float32),
            owner=self.owner, tint=self.tint, pattern_coords=self.pattern_coords, atlas=self.atlas, uv=self.uv, boxes=self.boxes,
            box_owner=self.box_owner, patterns=self.patterns, pattern=self.pattern, charts=self.charts,
        )  # fmt: skip


def objects_of(building: Building) -> list[ShellObject]:
    """Returns the objects of shell and furniture, and shadow casters, in the world frame."""
    objects = build_shell(building)
    for piece in building.pieces:
        solid = build_piece(piece.kind, piece.size, piece.seed, building.seed)
        matrix = pose_matrix(piece.position, piece.yaw)
        solid.transform(0, matrix)
        solid.boxes = [_rotated_box_bounds(matrix, low, high) for low, high in solid.boxes]
        objects.append(ShellObject(piece.name, CATALOGUE[piece.kind].semantic_class, solid))
    for body in building.bodies:
        shadow = shadow_caster(body)
        if shadow is not None:
            objects.append(ShellObject(f"shadow_{body.name}", "", shadow, exported=False))
    return objects


def _rotated_box_bounds(matrix: F64, low: F64, high: F64) -> tuple[F64, F64]:
    """Returns the axis-aligned bounding box of a rotated box."""
    corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
    moved = corners @ matrix[:3, :3].T + matrix[:3, 3]
    return moved.min(axis=0), moved.max(axis=0)


def assemble(building: Building, atlases: int, size_px: int) -> Assembly:
    """Models a building and places its triangles in light maps. ``size_px``: edge of each, texels."""
    objects = objects_of(building)
    rows: dict[str, list[NDArray[np.generic]]] = {
        k: [] for k in ("corners", "owner", "pattern", "tint", "pattern_coords", "thin", "uv", "chart", "importance")
    }
    patterns: list[str] = []
    charts = 0
    for number, item in enumerate(objects):
        for part in item.solid.parts:
            if part.surface.material not in patterns:
                patterns.append(part.surface.material)
            count = len(part.triangles)
            _, chart = np.unique(part.chart, return_inverse=True)
            rows["corners"].append(part.vertices[part.triangles])
            rows["owner"].append(np.full(count, number))
            rows["pattern"].append(np.full(count, patterns.index(part.surface.material)))
            rows["tint"].append(np.tile(part.surface.tint, (count, 1)))
            rows["pattern_coords"].append(part.pattern)
            rows["thin"].append(np.full(count, part.thin))
            rows["uv"].append(part.uv)
            rows["chart"].append(np.asarray(chart).reshape(-1) + charts)
            rows["importance"].append(part.importance)
            charts += int(chart.max()) + 1
    table = {k: np.concatenate(v) for k, v in rows.items()}
    unlit = [patterns.index(p) for p in UNLIT if p in patterns]
    is_blocker = np.array([not t.exported for t in objects])[table["owner"]]
    is_lit = ~np.isin(table["pattern"], unlit) & ~is_blocker
    atlas, uv, placed_charts, density = _place_in_atlases(table, is_lit, atlases, size_px)
    boxes = [(low, high) for t in objects for low, high in t.solid.boxes]
    return Assembly(
        [t.name for t in objects], [t.semantic_class for t in objects], [t.exported for t in objects], patterns,
        table["corners"], table["owner"], table["pattern"], table["tint"], table["pattern_coords"], table["thin"], atlas, uv,
        np.array(boxes), np.array([k for k, t in enumerate(objects) for _ in t.solid.boxes]), placed_charts, density,
    )  # fmt: skip


def _place_in_atlases(
    table: dict[str, NDArray[np.generic]], is_lit: NDArray[np.bool_], atlases: int, size_px: int
) -> tuple[I64, F64, I64, float]:
    chart = np.asarray(np.unique(table["chart"][is_lit], return_inverse=True)[1]).reshape(-1)
    count = int(chart.max()) + 1
    uv_m = np.asarray(table["uv"][is_lit], dtype=float)
    low, size = chart_extents(uv_m, chart, count)
    importance = np.zeros(count)
    np.maximum.at(importance, chart, np.asarray(table["importance"][is_lit], dtype=float))
    # Light changes quickly on small things.
    importance *= np.clip(np.sqrt(_LARGE_CHART_M / np.maximum(size.max(axis=1), 1e-3)), 1.0, _SMALL_CHART_FACTOR)
    placement = place_charts(size, importance, atlases, size_px)
    atlas = np.full(len(is_lit), NO_ATLAS)
    atlas[is_lit] = placement.atlas[chart]
    uv = np.zeros((len(is_lit), 3, 2))
    uv[is_lit] = place_corners(uv_m, chart, low, size, placement, size_px)
    charts = np.column_stack([placement.atlas, placement.low_px, placement.size_px])
    return atlas, uv, charts, placement.density


def shadow_caster(body: Body) -> ObjectBuilder | None:
    """Returns the shadow caster of a body, in the world frame; None for small bodies."""
    boxes = _CASTERS.get(body.model)
    if boxes is None:
        return None
    solid = ObjectBuilder(np.random.default_rng(0))
    for low, high in boxes:
        solid.box(low, high, Surface("outside", (0.5, 0.5, 0.5)), 0)
    solid.transform(0, pose_matrix(body.position, body.yaw))
    return solid
