"""Joins what was gathered of a scene into ``Batches``: cuts it into chunks, makes levels of detail, shares equal triangles. No OpenGL here."""

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
from gibson_sim.render.batching.batches import PLACEMENT, VERTEX, Batch, Batches, Kind, MapSet, Progress, settings
from gibson_sim.render.batching.material_table import MaterialTable
from gibson_sim.render.lod.clusters import build_clusters, places, simplifier

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]
CHUNK_TRIANGLES = 256
DETAIL_FROM = 50_000
"""Scenes with fewer triangles are always drawn with all of them."""
MOVING_DETAIL_UPTO = 60_000
"""Triangles of a link: with more it is always drawn with all of them, since images wait while levels of detail of what was spawned are made."""
BLEND_CHUNKS = 2048
"""Translucent piles are cut into about this many chunks or single triangles, since they are drawn in order of their distance."""


@dataclass(slots=True)
class Pile:
    """Parts of one link and batch while they are gathered."""

    vertices: list[NDArray[np.void]] = field(default_factory=list)
    triangles: list[I64] = field(default_factory=list)
    count: int = 0

    def add(self, vertices: NDArray[np.void], triangles: NDArray[np.uint32]) -> None:
        """Takes a part: (V,) of ``VERTEX``, and (F, 3) rows of these."""
        self.vertices.append(vertices)
        self.triangles.append(triangles.astype(np.int64) + self.count)
        self.count += len(vertices)


Key = tuple[bool, int, int, Kind, bool, bool, bool, int]
"""Moving, texture, maps, kind, unlit, colored, closed, link: the order of piles, so that those of one batch follow each other.
What an appearance changes is
not in it: levels of detail and the order of drawing, and with them depth, labels and normals, must not depend on appearances."""


def _unpacked_colors(packed: F32) -> F32:
    """Returns linear colours (V, 3), 0 to 1."""
    return np.ascontiguousarray(packed).view("<u2").reshape(-1, 4)[:, :3].astype(np.float32) / np.float32(65535.0)


class Joiner:
    """Puts piles behind one another into the arrays of ``Batches``."""

    def __init__(self, coarser: bool, progress: Progress) -> None:
        self._coarser, self._progress = coarser, progress
        self._vertices: list[NDArray[np.void]] = []
        self._indices: list[I64] = []
        self._chunks: dict[str, list[NDArray[Any]]] = {
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
        self._chunks["placement"].append(np.zeros(1, dtype=PLACEMENT))  # of all that is static
        self._shapes: dict[bytes, dict[str, NDArray[Any]]] = {}
        self._index_count = self._vertex_count = self._chunk_count = self._group_count = self._triangles = 0

    def join(
        self,
        piles: dict[Key, Pile],
        table: MaterialTable,
        textures: tuple[TextureSource, ...],
        map_sets: tuple[MapSet, ...],
        solids: tuple[NDArray[np.float64], I64],
        files: tuple[Path, ...],
        warnings: tuple[str, ...],
    ) -> Batches:
        """Returns everything; call it once.

        Args:
            piles: parts of one link and batch each.
            table: materials that the vertices name.
            textures: that the keys of the piles number.
            map_sets: likewise.
            solids: ``solid_box`` and ``solid_link``.
            files: what was read.
            warnings: what was left out.

        Raises:
            ConfigError: there are more triangles than can be drawn.
        """
        materials = table.materials()
        matte = (materials["surface"][:, 0] <= 0.0) & (materials["surface"][:, 1] >= MATTE_ROUGHNESS)
        with_appearance = np.array([bool(appearance) for _, appearance in table.rows], dtype=bool)
        total = sum(len(t) for pile in piles.values() for t in pile.triangles)
        self._coarser &= total >= DETAIL_FROM
        if self._coarser and simplifier() is None:
            warnings += (
                f"{total} triangles are drawn without levels of detail, slowly: install meshoptimizer (pip install meshoptimizer)",
            )
        shared = _shared_places(piles) if self._coarser else {}
        batches: list[Batch] = []
        for key in sorted(piles):
            self._progress("levels of detail", self._triangles / max(total, 1))
            first = self._chunk_count
            self._add(key, piles[key], shared.get(key))
            moving, texture, maps, kind, unlit, colored, closed, _ = key
            rows = np.unique(np.concatenate([v["material"] for v in piles[key].vertices]))
            material = int(rows[0]) if len(rows) == 1 else -1
            shiny = not matte[rows].all() or (maps >= 0 and map_sets[maps][0] is not None)
            glossy, looked = not unlit and shiny, bool(with_appearance[rows].any())
            if batches and settings(batches[-1]) == (moving, texture, maps, kind, unlit, colored, closed):
                last = batches.pop()
                first, material = last.first_chunk, material if material == last.material else -1
                glossy, looked = glossy or last.glossy, looked or last.has_appearance
            span = (first, self._chunk_count)
            batches.append(Batch(texture, kind, maps, unlit, glossy, looked, colored, moving, closed, material, *span))
        if self._index_count >= 2**31:
            raise ConfigError(
                f"the scene has {self._triangles} triangles, at most {2**31 // 6} can be drawn; simplify its meshes"
            )
        c = self._chunks
        return Batches(
            vertices=np.concatenate(self._vertices) if self._vertices else np.zeros(0, dtype=VERTEX),
            indices=_joined(self._indices, np.uint32),
            materials=materials,
            appearances=table.appearances(),
            patterns=table.patterns,
            map_sets=map_sets,
            batches=tuple(batches),
            textures=textures,
            chunk_first=_joined(c["first"], np.uint32),
            chunk_count=_joined(c["count"], np.uint32),
            chunk_box=_joined(c["box"], np.float64).reshape(-1, 6),
            chunk_link=_joined(c["link"], np.int64),
            chunk_placement=_joined(c["placed"], np.uint32),
            placements=np.concatenate(c["placement"]),
            chunk_group=_joined(c["group"], np.int64),
            chunk_next_group=_joined(c["next"], np.int64),
            group_error=_joined(c["error"], np.float64),
            group_box=_joined(c["error_box"], np.float64).reshape(-1, 6),
            group_link=_joined(c["error_link"], np.int64),
            solid_box=solids[0],
            solid_link=solids[1],
            triangles=self._triangles,
            files=files,
            warnings=warnings,
        )

    def _add(self, key: Key, pile: Pile, fixed: NDArray[np.bool_] | None) -> None:
        """Appends the chunks of one pile, all levels; what equals an earlier pile but for label, material and link uses its triangles."""
        _, texture, maps, kind, _, colored, closed, link = key
        vertices = np.concatenate(pile.vertices)
        placement = np.zeros(1, dtype=PLACEMENT)
        if link:
            placement["link"] = link
            for name in ("label", "material"):
                if (vertices[name] == vertices[name][0]).all():
                    placement[name] = vertices[name][0]
                    vertices[name] = 0
        triangles = np.concatenate(pile.triangles)
        if not closed:  # closed solids are wound as they should be
            triangles = _wound(vertices, triangles)
        size = CHUNK_TRIANGLES
        if kind == "blend":
            size = min(max(len(triangles) // BLEND_CHUNKS, 1), size)
        slow = bool(link) and len(triangles) > MOVING_DETAIL_UPTO
        coarser, textured = self._coarser and kind != "blend" and not slow, max(texture, maps) >= 0
        digest = hashlib.sha256(repr((size, coarser, textured, colored)).encode())
        for array in (vertices, triangles, *(() if fixed is None else (fixed,))):
            digest.update(np.ascontiguousarray(array).view(np.uint8).data)
        shape = self._shapes.get(digest.digest())
        if shape is None:
            shape = self._shape(vertices, triangles, size, fixed, coarser, textured, colored)
            self._shapes[digest.digest()] = shape
        chunks, groups = len(shape["first"]), len(shape["error"])
        row = 0 if not link else sum(map(len, self._chunks["placement"]))
        if link:
            self._chunks["placement"].append(placement)
        columns = {
            **shape,
            "link": np.full(chunks, link),
            "placed": np.full(chunks, row),
            "group": np.where(shape["group"] < 0, -1, shape["group"] + self._group_count),
            "next": np.where(shape["next"] < 0, -1, shape["next"] + self._group_count),
            "error_link": np.full(groups, link),
        }
        for name, column in columns.items():
            self._chunks[name].append(column)
        self._chunk_count += chunks
        self._group_count += groups
        self._triangles += len(triangles)

    def _shape(
        self,
        vertices: NDArray[np.void],
        triangles: I64,
        size: int,
        fixed: NDArray[np.bool_] | None,
        coarser: bool,
        textured: bool,
        colored: bool,
    ) -> dict[str, NDArray[Any]]:
        """Appends triangles, all levels, and returns their chunks and groups, the groups counted from 0."""
        clusters = build_clusters(
            vertices["position"],
            vertices["normal"].astype(np.float32) / np.float32(32767.0),
            vertices["uv"] if textured else np.zeros_like(vertices["uv"]),
            triangles,
            size,
            fixed,
            coarser,
            _unpacked_colors(vertices["uv"]) if colored else None,
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
        """Appends triangles with a copy of their vertices in the order of their first use.

        The vertex stage of a software renderer lives on memory locality, so a coarse level must not fetch from all over the fine one.
        """
        used, first, inverse = np.unique(triangles, return_index=True, return_inverse=True)
        order = np.argsort(first, kind="stable")
        new_number = np.empty(len(used), dtype=np.int64)
        new_number[order] = np.arange(len(used))
        self._indices.append(new_number[inverse.ravel()] + self._vertex_count)
        self._vertices.append(vertices[used[order]])
        self._vertex_count += len(used)
        self._index_count += triangles.size


def _wound(vertices: NDArray[np.void], triangles: I64) -> I64:
    """Returns triangles whose corners go round as their normals say, counter-clockwise seen from outside."""
    a, b, c = (vertices["position"][triangles[:, k]] for k in range(3))
    outward = vertices["normal"][triangles].sum(axis=1, dtype=np.int64)
    wrong = np.einsum("fk,fk->f", np.cross(b - a, c - a), outward) < 0.0
    triangles[wrong] = triangles[wrong][:, ::-1]
    return triangles


def _joined(pieces: Sequence[NDArray[Any]], kind: type[np.generic]) -> NDArray[Any]:
    return np.concatenate(pieces).astype(kind) if pieces else np.zeros(0, dtype=kind)


def _shared_places(piles: dict[Key, Pile]) -> dict[Key, NDArray[np.bool_]]:
    """Returns for each pile which vertices lie where another pile of its link has one too: moving them would open cracks."""
    shared: dict[Key, NDArray[np.bool_]] = {}
    for keys in _by_link(piles):
        sizes = [piles[key].count for key in keys]
        if len(keys) < 2:
            continue
        place = places(np.concatenate([v["position"] for key in keys for v in piles[key].vertices]))
        owner = np.repeat(np.arange(len(keys)), sizes)
        lowest, highest = np.full(int(place.max()) + 1, len(keys)), np.full(int(place.max()) + 1, -1)
        np.minimum.at(lowest, place, owner)
        np.maximum.at(highest, place, owner)
        both = (lowest < highest)[place]
        shared.update(zip(keys, np.split(both, np.cumsum(sizes)[:-1]), strict=True))
    return shared


def _by_link(piles: dict[Key, Pile]) -> Iterator[list[Key]]:
    for link in sorted({key[-1] for key in piles}):
        yield [key for key in piles if key[-1] == link]
