"""Assembles the submeshes of a scene into ``SceneGeometry``: clusters, levels of detail, triangles shared by equal bodies. No OpenGL."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import ConfigError
from gibson_sim.formats.mesh import MATTE_ROUGHNESS, TextureSource
from gibson_sim.render.batching.material_table import MaterialTable
from gibson_sim.render.batching.scene_geometry import (
    PLACEMENT,
    VERTEX,
    AlphaMode,
    Batch,
    LightMap,
    MapSet,
    Progress,
    SceneGeometry,
    joined_dtype,
    settings,
    with_dtype,
)
from gibson_sim.render.lod.clusters import build_clusters, simplifier, weld

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]
CLUSTER_TRIANGLES = 256
"""Maximum number of triangles in a cluster."""
DETAIL_FROM = 50_000
"""Minimum number of triangles of a scene with levels of detail."""
MOVING_DETAIL_UPTO = 60_000
"""Maximum number of triangles of a link with levels of detail: rendering blocks while those of a spawned body are built."""
BLEND_CLUSTERS = 2048
"""Maximum number of clusters of a translucent submesh, which are drawn sorted by distance."""


@dataclass(slots=True)
class Submesh:
    """Triangles of one link with one set of draw settings, collected from its visuals."""

    vertices: list[NDArray[np.void]] = field(default_factory=list)
    triangles: list[I64] = field(default_factory=list)
    count: int = 0

    def add(self, vertices: NDArray[np.void], triangles: NDArray[np.uint32]) -> None:
        """Adds triangles: (V,) of ``VERTEX``, and (F, 3) rows of these."""
        self.vertices.append(vertices)
        self.triangles.append(triangles.astype(np.int64) + self.count)
        self.count += len(vertices)


SubmeshKey = tuple[bool, int, int, int, AlphaMode, bool, bool, bool, int]
"""Moving, texture, maps, light map, alpha mode, unlit, colored, closed, link. Submeshes are sorted by it, so those of one batch are consecutive. It
does not depend on appearances: these must change neither levels of detail nor the drawing order, and thus neither depth, labels nor
normals."""


def _colors_of(vertices: NDArray[np.void], textured: bool) -> F32:
    """Returns linear colours (V, 3), 0 to 1."""
    packed = vertices["color"] if textured else np.ascontiguousarray(vertices["uv"]).view("<u2").reshape(-1, 4)
    return np.asarray(packed[:, :3].astype(np.float32) / np.float32(65535.0), dtype=np.float32)


def _light_uvs_of(vertices: NDArray[np.void]) -> F32 | None:
    """Returns coordinates in the light map, (V, 2), 0 to 1, or None if the vertices have none."""
    if "light_uv" not in (vertices.dtype.names or ()):
        return None
    return np.asarray(vertices["light_uv"].astype(np.float32) / np.float32(65535.0), dtype=np.float32)


def _joined_vertices(arrays: Sequence[NDArray[np.void]]) -> NDArray[np.void]:
    """Returns all vertices as one array, with all fields that any of them have."""
    dtype = joined_dtype(array.dtype for array in arrays)
    return np.concatenate([with_dtype(array, dtype) for array in arrays]) if arrays else np.zeros(0, dtype=VERTEX)


class GeometryAssembler:
    """Concatenates submeshes into the arrays of ``SceneGeometry``."""

    def __init__(self, levels_of_detail: bool, progress: Progress) -> None:
        self._levels_of_detail, self._progress = levels_of_detail, progress
        self._vertices: list[NDArray[np.void]] = []
        self._indices: list[I64] = []
        self._clusters: dict[str, list[NDArray[Any]]] = {
            name: []
            for name in (
                "first",
                "count",
                "box",
                "link",
                "placed",
                "group",
                "next",
                "error",
                "error_box",
                "error_link",
                "placement",
            )
        }
        self._clusters["placement"].append(np.zeros(1, dtype=PLACEMENT))  # shared by all static clusters
        self._shapes: dict[bytes, dict[str, NDArray[Any]]] = {}
        self._index_count = self._vertex_count = self._cluster_count = self._group_count = self._triangles = 0

    def assemble(
        self,
        submeshes: dict[SubmeshKey, Submesh],
        table: MaterialTable,
        textures: tuple[TextureSource, ...],
        map_sets: tuple[MapSet, ...],
        light_maps: tuple[LightMap, ...],
        closed: tuple[NDArray[np.float64], I64],
        files: tuple[Path, ...],
        warnings: tuple[str, ...],
    ) -> SceneGeometry:
        """Returns the geometry; call it once.

        Args:
            submeshes: all submeshes of the scene.
            table: materials referenced by the vertices.
            textures: textures, in the order of their numbers in the keys of the submeshes.
            map_sets: material maps, in the same order as the keys' numbers.
            light_maps: light maps, likewise.
            closed: ``closed_box`` and ``closed_link``.
            files: files read so far.
            warnings: warnings so far.

        Raises:
            ConfigError: the scene has more triangles than can be drawn.
        """
        materials = table.materials()
        matte = (materials["surface"][:, 0] <= 0.0) & (materials["surface"][:, 1] >= MATTE_ROUGHNESS)
        with_appearance = np.array([bool(appearance) for _, appearance in table.rows], dtype=bool)
        total = sum(len(t) for submesh in submeshes.values() for t in submesh.triangles)
        self._levels_of_detail &= total >= DETAIL_FROM
        if self._levels_of_detail and simplifier() is None:
            warnings += (
                f"{total} triangles are drawn without levels of detail, which is slow: install meshoptimizer (pip install meshoptimizer)",
            )
        shared = _shared_vertices(submeshes) if self._levels_of_detail else {}
        batches: list[Batch] = []
        for key in sorted(submeshes):
            self._progress("levels of detail", self._triangles / max(total, 1))
            first = self._cluster_count
            self._add(key, submeshes[key], shared.get(key))
            moving, texture, maps, light, alpha_mode, unlit, colored, is_closed, _ = key
            rows = np.unique(np.concatenate([v["material"] for v in submeshes[key].vertices]))
            material = int(rows[0]) if len(rows) == 1 else -1
            shiny = not matte[rows].all() or (maps >= 0 and map_sets[maps][0] is not None)
            glossy, has_appearance = not unlit and shiny, bool(with_appearance[rows].any())
            if batches and settings(batches[-1]) == key[:-1]:
                last = batches.pop()
                first, material = last.first_cluster, material if material == last.material else -1
                glossy, has_appearance = glossy or last.glossy, has_appearance or last.has_appearance
            span = (first, self._cluster_count)
            batches.append(
                Batch(
                    texture, alpha_mode, maps, light, unlit, glossy, has_appearance, colored, moving, is_closed, material, *span
                )
            )
        self._progress("levels of detail", 1.0)
        if self._index_count >= 2**31:
            raise ConfigError(
                f"the scene has {self._triangles} triangles, at most {2**31 // 6} can be drawn; simplify its meshes"
            )
        c = self._clusters
        return SceneGeometry(
            vertices=_joined_vertices(self._vertices),
            indices=_joined(self._indices, np.uint32),
            materials=materials,
            appearances=table.appearances(),
            patterns=table.patterns,
            map_sets=map_sets,
            light_maps=light_maps,
            batches=tuple(batches),
            textures=textures,
            cluster_first=_joined(c["first"], np.uint32),
            cluster_count=_joined(c["count"], np.uint32),
            cluster_box=_joined(c["box"], np.float64).reshape(-1, 6),
            cluster_link=_joined(c["link"], np.int64),
            cluster_placement=_joined(c["placed"], np.uint32),
            placements=np.concatenate(c["placement"]),
            cluster_group=_joined(c["group"], np.int64),
            cluster_next_group=_joined(c["next"], np.int64),
            group_error=_joined(c["error"], np.float64),
            group_box=_joined(c["error_box"], np.float64).reshape(-1, 6),
            group_link=_joined(c["error_link"], np.int64),
            closed_box=closed[0],
            closed_link=closed[1],
            triangles=self._triangles,
            files=files,
            warnings=warnings,
        )

    def _add(self, key: SubmeshKey, submesh: Submesh, fixed: NDArray[np.bool_] | None) -> None:
        """Appends the clusters of a submesh, all levels; reuses the triangles of an earlier one that differs only in label, material or link."""
        _, texture, maps, _, alpha_mode, _, colored, closed, link = key
        vertices = _joined_vertices(submesh.vertices)
        placement = np.zeros(1, dtype=PLACEMENT)
        if link:
            placement["link"] = link
            for name in ("label", "material"):
                if (vertices[name] == vertices[name][0]).all():
                    placement[name] = vertices[name][0]
                    vertices[name] = 0
        triangles = np.concatenate(submesh.triangles)
        if not closed:  # closed surfaces are wound outwards
            triangles = _with_outward_winding(vertices, triangles)
        size = CLUSTER_TRIANGLES
        if alpha_mode == "blend":
            size = min(max(len(triangles) // BLEND_CLUSTERS, 1), size)
        slow = bool(link) and len(triangles) > MOVING_DETAIL_UPTO
        levels_of_detail, textured = self._levels_of_detail and alpha_mode != "blend" and not slow, max(texture, maps) >= 0
        digest = hashlib.sha256(repr((size, levels_of_detail, textured, colored, vertices.dtype.names)).encode())
        for array in (vertices, triangles, *(() if fixed is None else (fixed,))):
            digest.update(np.ascontiguousarray(array).view(np.uint8).data)
        shape = self._shapes.get(digest.digest())
        if shape is None:
            shape = self._shape(vertices, triangles, size, fixed, levels_of_detail, textured, colored)
            self._shapes[digest.digest()] = shape
        clusters, groups = len(shape["first"]), len(shape["error"])
        row = 0 if not link else sum(map(len, self._clusters["placement"]))
        if link:
            self._clusters["placement"].append(placement)
        columns = {
            **shape,
            "link": np.full(clusters, link),
            "placed": np.full(clusters, row),
            "group": np.where(shape["group"] < 0, -1, shape["group"] + self._group_count),
            "next": np.where(shape["next"] < 0, -1, shape["next"] + self._group_count),
            "error_link": np.full(groups, link),
        }
        for name, column in columns.items():
            self._clusters[name].append(column)
        self._cluster_count += clusters
        self._group_count += groups
        self._triangles += len(triangles)

    def _shape(
        self,
        vertices: NDArray[np.void],
        triangles: I64,
        size: int,
        fixed: NDArray[np.bool_] | None,
        levels_of_detail: bool,
        textured: bool,
        colored: bool,
    ) -> dict[str, NDArray[Any]]:
        """Appends triangles, all levels, and returns the columns of their clusters and groups; groups are numbered from 0."""
        clusters = build_clusters(
            vertices["position"],
            vertices["normal"].astype(np.float32) / np.float32(32767.0),
            vertices["uv"] if textured else np.zeros_like(vertices["uv"]),
            triangles,
            size,
            fixed,
            levels_of_detail,
            _colors_of(vertices, textured) if colored else None,
            _light_uvs_of(vertices),
        )
        starts, ends = clusters.starts, clusters.ends
        corners = vertices["position"][clusters.triangles]
        low = np.minimum.reduceat(corners.min(axis=1), starts, axis=0).astype(np.float64)
        high = np.maximum.reduceat(corners.max(axis=1), starts, axis=0).astype(np.float64)
        for level in np.unique(clusters.level):
            rows = np.flatnonzero(clusters.level == level)
            self._add_level(vertices, clusters.triangles[starts[rows[0]] : ends[rows[-1]]])
        box = clusters.group_box
        return {
            "first": 3 * starts + self._index_count - clusters.triangles.size,
            "count": 3 * (ends - starts),
            "box": np.hstack([(low + high) / 2, (high - low) / 2]),
            "group": clusters.group,
            "next": clusters.next_group,
            "error": clusters.group_error,
            "error_box": np.hstack([(box[:, :3] + box[:, 3:]) / 2, (box[:, 3:] - box[:, :3]) / 2]),
        }

    def _add_level(self, vertices: NDArray[np.void], triangles: I64) -> None:
        """Appends triangles with a copy of their vertices in the order of first use.

        The vertex stage of a software renderer needs memory locality: vertices of a coarse level must not be scattered over the fine one.
        """
        used, first, inverse = np.unique(triangles, return_index=True, return_inverse=True)
        order = np.argsort(first, kind="stable")
        new_index = np.empty(len(used), dtype=np.int64)
        new_index[order] = np.arange(len(used))
        self._indices.append(new_index[inverse.ravel()] + self._vertex_count)
        self._vertices.append(vertices[used[order]])
        self._vertex_count += len(used)
        self._index_count += triangles.size


def _with_outward_winding(vertices: NDArray[np.void], triangles: I64) -> I64:
    """Returns triangles wound to match their normals: counter-clockwise seen from outside."""
    a, b, c = (vertices["position"][triangles[:, k]] for k in range(3))
    outward = vertices["normal"][triangles].sum(axis=1, dtype=np.int64)
    wrong = np.einsum("fk,fk->f", np.cross(b - a, c - a), outward) < 0.0
    triangles[wrong] = triangles[wrong][:, ::-1]
    return triangles


def _joined(arrays: Sequence[NDArray[Any]], dtype: type[np.generic]) -> NDArray[Any]:
    return np.concatenate(arrays).astype(dtype) if arrays else np.zeros(0, dtype=dtype)


def _shared_vertices(submeshes: dict[SubmeshKey, Submesh]) -> dict[SubmeshKey, NDArray[np.bool_]]:
    """Returns for each submesh a mask of the vertices shared with another submesh of its link: moving them would open cracks."""
    shared: dict[SubmeshKey, NDArray[np.bool_]] = {}
    for keys in _by_link(submeshes):
        sizes = [submeshes[key].count for key in keys]
        if len(keys) < 2:
            continue
        welded = weld(np.concatenate([v["position"] for key in keys for v in submeshes[key].vertices]))
        owner = np.repeat(np.arange(len(keys)), sizes)
        lowest, highest = np.full(int(welded.max()) + 1, len(keys)), np.full(int(welded.max()) + 1, -1)
        np.minimum.at(lowest, welded, owner)
        np.maximum.at(highest, welded, owner)
        both = (lowest < highest)[welded]
        shared.update(zip(keys, np.split(both, np.cumsum(sizes)[:-1]), strict=True))
    return shared


def _by_link(submeshes: dict[SubmeshKey, Submesh]) -> Iterator[list[SubmeshKey]]:
    for link in sorted({key[-1] for key in submeshes}):
        yield [key for key in submeshes if key[-1] == link]
