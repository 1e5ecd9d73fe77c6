"""Merges all visuals of a scene into few arrays that a GPU draws quickly. No OpenGL here.

Triangles that share texture, transparency and shading form a batch, moving ones apart from static ones; batches consist of chunks:
neighbouring triangles of one link, each with its box, at several levels of detail (``clusters``). Static triangles stand in the
world frame (link number 0), others in the frame of their link.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import ConfigError, GibsonSimError
from gibson_sim.geometry.colours import linear16_from_srgb8, linear_from_srgb
from gibson_sim.geometry.transforms import matrix_from_pose, transform_points
from gibson_sim.render.clusters import build_clusters, places, simplifier
from gibson_sim.robots.spec import Look, Shape, VisualSpec
from gibson_sim.scenes.looks import apply_look, is_drawn, pattern_colors, pattern_pictures, tint_matrix
from gibson_sim.scenes.mesh_types import MATTE_ROUGHNESS, Material, Mesh, MeshPart, TextureSource
from gibson_sim.types import Rgba

Loader = Callable[[Shape], Mesh]
Progress = Callable[[str, float], None]
"""Called with what is done and how much of it, 0 to 1."""
Kind = Literal["opaque", "mask", "blend"]
F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

VERTEX = np.dtype([("position", "<f4", 3), ("normal", "<i2", 3), ("material", "<u2"), ("uv", "<f4", 2), ("label", "<u2", 2)])
PLACEMENT = np.dtype([("link", "<u4"), ("label", "<u2", 2), ("material", "<u4")])
"""One use of triangles that several bodies share: link, and what is added to the label and material numbers of the vertices."""
MATERIAL = np.dtype([("color", "<f4", 4), ("surface", "<f4", 4), ("glow", "<f4", 4), ("maps", "<f4", 4)])
"""Base colour (linear) and alpha; metallic, roughness, alpha below which nothing is solid, 1 = unlit; emission; and of the further
textures the scale of normals, the strength of occlusion, and how much they say of metallic and of roughness."""
LOOK = np.dtype([("tint", "<f4", (3, 4)), ("first", "<f4", 4), ("second", "<f4", 4)])
"""``Look`` of looks.glsl."""
PLAIN_LOOK = (*np.eye(3, 4).ravel().tolist(), 0.0, 0.0, 0.0, -1.0, 1.0, 1.0, 1.0, 1.0)
"""One that changes nothing; the fourth number of ``first`` is the layer of the pattern, -1 = none."""
MapSet = tuple[TextureSource | None, TextureSource | None, TextureSource | None, TextureSource | None]
"""Metallic-roughness, normals, occlusion, emission."""
CHUNK_TRIANGLES = 256
DETAIL_FROM = 50_000
"""Scenes with fewer triangles are always drawn with all of them."""
BLEND_CHUNKS = 2048
"""Translucent piles are cut into about this many chunks or single triangles, since they are drawn in order of their distance."""
MAX_LABEL = 2**16 - 1
"""Greatest number of a semantic class, an instance or a material."""
SOLID_ALPHA = 0.9
"""Where a blended material has at least this alpha it is drawn as solid, so that it also has a depth."""


@dataclass(frozen=True, slots=True)
class Batch:
    """Chunks that are drawn with the same settings."""

    texture: int
    """Index in ``Batches.textures``; -1 = none."""
    kind: Kind
    maps: int
    """Index in ``Batches.map_sets``; -1 = none."""
    unlit: bool
    """No light falls on any of it."""
    glossy: bool
    """Some of it shows highlights."""
    looked: bool
    """Some of it wears a tint or a pattern."""
    colored: bool
    """Its vertices have colours, in the place of texture coordinates."""
    moving: bool
    """Its chunks belong to links, not to the world."""
    material: int
    """Index in ``Batches.materials``, where all its triangles have the same; -1 = they differ."""
    first_chunk: int
    end_chunk: int


@dataclass(frozen=True, slots=True, eq=False)
class Batches:
    """All triangles of a scene."""

    vertices: NDArray[np.void]
    """(V,) of ``VERTEX``."""
    indices: NDArray[np.uint32]
    """(3 F,), rows of ``vertices``."""
    materials: NDArray[np.void]
    """(M,) of ``MATERIAL``."""
    looks: NDArray[np.void]
    """(M,) of ``LOOK``, where any batch is ``looked``; else (0,)."""
    patterns: NDArray[np.uint8]
    """(L, S, S, 3), sRGB: layers that looks name."""
    map_sets: tuple[MapSet, ...]
    batches: tuple[Batch, ...]
    textures: tuple[TextureSource, ...]
    chunk_first: NDArray[np.uint32]
    """(C,), position in ``indices``."""
    chunk_count: NDArray[np.uint32]
    """(C,), how many indices."""
    chunk_box: F64
    """(C, 6), centre and half the size, metres, frame of the link."""
    chunk_link: I64
    """(C,), 0 = the world, else 1 + index in ``links``."""
    chunk_placement: NDArray[np.uint32]
    """(C,), row of ``placements``."""
    placements: NDArray[np.void]
    """(P,) of ``PLACEMENT``; the first is that of all static chunks."""
    chunk_group: I64
    """(C,), as ``Clusters.group``, numbered through the whole scene."""
    chunk_next_group: I64
    """(C,), as ``Clusters.next_group``."""
    group_error: F64
    """(G,), metres."""
    group_box: F64
    """(G, 6), centre and half the size, metres, frame of the link."""
    group_link: I64
    """(G,), as ``chunk_link``."""
    triangles: int
    """Number of triangles at the finest level."""
    files: tuple[Path, ...]
    """What was read."""
    warnings: tuple[str, ...]


@dataclass(slots=True)
class _Pile:
    """Parts of one link and batch while they are gathered."""

    vertices: list[NDArray[np.void]] = field(default_factory=list)
    triangles: list[I64] = field(default_factory=list)
    count: int = 0

    def add(self, vertices: NDArray[np.void], triangles: NDArray[np.uint32]) -> None:
        self.vertices.append(vertices)
        self.triangles.append(triangles.astype(np.int64) + self.count)
        self.count += len(vertices)


_Key = tuple[bool, int, int, Kind, bool, bool, int]
"""Moving, texture, maps, kind, unlit, colored, link: the order of piles, so that those of one batch follow each other. What a look changes is
not in it: levels of detail and the order of drawing, and with them depth, labels and normals, must not depend on looks."""


def build_batches(
    visuals: Sequence[VisualSpec],
    links: Sequence[str],
    loader: Loader,
    labels: Sequence[tuple[int, int]] = (),
    *,
    coarser: bool = True,
    progress: Progress | None = None,
) -> Batches:
    """Returns the triangles of all visuals; a visual that cannot be loaded is left out with a warning.

    Args:
        visuals: what to draw.
        links: names of the moving links, in the order of ``SceneState.links``.
        loader: returns the mesh of a shape, or raises a ``GibsonSimError``.
        labels: semantic class and instance of each visual; empty = all 0.
        coarser: make levels of detail.
        progress: told how far it is.
    """
    highest = max((max(label) for label in labels), default=0)
    if highest > MAX_LABEL:
        raise ConfigError(f"the scene has {highest} classes or instances, at most {MAX_LABEL} can be told apart in an image")
    progress = progress or (lambda what, part: None)
    link_numbers = {"": 0, **{name: i + 1 for i, name in enumerate(links)}}
    piles: dict[_Key, _Pile] = {}
    textures: dict[int, tuple[int, TextureSource]] = {}
    map_sets: dict[tuple[int, ...], tuple[int, MapSet]] = {}
    files: dict[Path, None] = {}
    warnings: list[str] = []
    table = _MaterialTable([v.look for v in visuals if v.look is not None], warnings.append)
    for k, (visual, label) in enumerate(zip(visuals, labels or [(0, 0)] * len(visuals), strict=True)):
        progress("reading meshes", k / len(visuals))
        if visual.link not in link_numbers:
            warnings.append(f"visual {visual.name!r}: link {visual.link!r} is not in the scene; it is not drawn")
            continue
        try:
            mesh = loader(visual.shape)
        except GibsonSimError as e:
            warnings.append(f"visual {visual.name!r} is not drawn: {e}")
            continue
        warnings += [w for w in mesh.warnings if w not in warnings]
        files.update(dict.fromkeys(mesh.files))
        if visual.look is not None and visual.look.pattern is not None and visual.look.pattern.image:
            files[Path(visual.look.pattern.image)] = None
        link = link_numbers[visual.link]
        for part in mesh.parts:
            material = part.material if visual.color is None else _plain(visual.color)
            texture = material.texture if part.uvs is not None else None
            number = -1 if texture is None else textures.setdefault(id(texture), (len(textures), texture))[0]
            maps = -1
            if part.uvs is not None and material.has_maps:
                found = _map_set(material)
                maps = map_sets.setdefault(tuple(map(id, found)), (len(map_sets), found))[0]
            row = table.row(material if part.uvs is not None else replace(material, texture=None), visual.look)
            vertices = _vertices(part, row, matrix_from_pose(visual.pose), label)
            colored = material.colored and part.colors is not None
            if colored:
                vertices["uv"] = _packed_colors(part.colors)
            key = (link > 0, number, maps, _kind(material, texture), material.unlit, colored, link)
            piles.setdefault(key, _Pile()).add(vertices, part.triangles)
    if len(table.rows) > MAX_LABEL:
        raise ConfigError(f"the scene has {len(table.rows)} different materials, at most {MAX_LABEL} can be drawn")
    shown = tuple(t for _, t in textures.values())
    return _Joiner(coarser, progress).join(
        piles, table, shown, tuple(m for _, m in map_sets.values()), tuple(files), tuple(warnings)
    )


def _plain(color: Rgba) -> Material:
    return Material(base_color=color, alpha_mode="blend" if color[3] < 1.0 else "opaque")


def _kind(material: Material, texture: TextureSource | None) -> Kind:
    """Returns how to draw it: files often ask for blending where nothing is translucent, which would cost depth and time."""
    if material.alpha_mode == "opaque":
        return "opaque"
    lowest = material.base_color[3]
    if texture is not None and texture.pixels.shape[2] == 4:
        lowest *= float(texture.pixels[:, :, 3].min()) / 255.0
    if lowest >= _solid_alpha(material):
        return "opaque"
    return "mask" if material.alpha_mode == "mask" else "blend"


def _solid_alpha(material: Material) -> float:
    return material.alpha_cutoff if material.alpha_mode == "mask" else SOLID_ALPHA


def _map_set(material: Material) -> MapSet:
    return (material.metallic_roughness_texture, material.normal_texture, material.occlusion_texture, material.emissive_texture)


class _MaterialTable:
    """Rows of ``MATERIAL``, and of ``LOOK`` beside them."""

    def __init__(self, looks: Sequence[Look], warn: Callable[[str], None]) -> None:
        self.rows: dict[tuple[tuple[float, ...], tuple[float, ...]], int] = {}
        patterns = list(dict.fromkeys(look.pattern for look in looks if look.pattern is not None))
        self._layers, self.patterns = pattern_pictures(patterns, warn)

    def row(self, material: Material, look: Look | None) -> int:
        """Returns the row of a material under a look."""
        worn = material if look is None else apply_look(material, look)
        linear = linear_from_srgb(worn.base_color[:3]).tolist()
        # A look that says how rough it is means the surface, not a factor on a map.
        from_map = [float(look is None or value is None) for value in (look and look.metallic, look and look.roughness)]
        values = (
            *linear, worn.base_color[3],
            worn.metallic, worn.roughness, min(max(_solid_alpha(worn), 0.0), 1.0), float(worn.unlit),
            *worn.emissive, 0.0,
            0.0 if worn.normal_texture is None else worn.normal_scale, worn.occlusion_strength, *from_map,
        )  # fmt: skip
        return self.rows.setdefault((values, self._look(material, look)), len(self.rows))

    def _look(self, material: Material, look: Look | None) -> tuple[float, ...]:
        if look is None or not is_drawn(material, look):
            return ()
        layer, size = -1, 1.0
        colors: tuple[tuple[float, ...], tuple[float, ...]] = ((0.0,) * 3, (1.0,) * 3)
        if look.pattern is not None:
            layer, size, colors = self._layers[look.pattern], look.pattern.size, pattern_colors(look.pattern)
        first, second = linear_from_srgb(colors).tolist()
        tint = np.hstack([tint_matrix(look), np.zeros((3, 1))])
        return (*tint.ravel().tolist(), *first, float(layer), *second, 1.0 / size)

    def materials(self) -> NDArray[np.void]:
        """Returns (M,) of ``MATERIAL``."""
        return np.array([v for v, _ in self.rows], dtype=np.float32).reshape(-1, 16).view(MATERIAL)[:, 0]

    def looks(self) -> NDArray[np.void]:
        """Returns (M,) of ``LOOK``, or (0,) if there are none."""
        worn = [look for _, look in self.rows]
        if not any(worn):
            return np.zeros(0, dtype=LOOK)
        return np.array([look or PLAIN_LOOK for look in worn], dtype=np.float32).view(LOOK)[:, 0]


def _vertices(part: MeshPart, material: int, T_link_visual: F64, label: tuple[int, int]) -> NDArray[np.void]:
    out = np.zeros(len(part.vertices), dtype=VERTEX)
    out["position"] = transform_points(T_link_visual, part.vertices)
    out["normal"] = np.rint(np.clip(part.normals @ T_link_visual[:3, :3].T, -1.0, 1.0) * 32767.0)
    if part.uvs is not None:
        out["uv"] = part.uvs
    out["material"] = min(material, MAX_LABEL)
    out["label"] = label
    return out


def _packed_colors(colors: NDArray[np.uint8] | None) -> F32:
    """Returns (V, 2) float32 whose bytes are linear red, green, blue and 0 as 16-bit numbers, of sRGB colours (V, 3)."""
    assert colors is not None
    out = np.zeros((len(colors), 4), dtype="<u2")
    out[:, :3] = linear16_from_srgb8(colors)
    return out.view("<f4")


def _unpacked_colors(packed: F32) -> F32:
    """Returns linear colours (V, 3), 0 to 1."""
    return np.ascontiguousarray(packed).view("<u2").reshape(-1, 4)[:, :3].astype(np.float32) / np.float32(65535.0)


class _Joiner:
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
        piles: dict[_Key, _Pile],
        table: _MaterialTable,
        textures: tuple[TextureSource, ...],
        map_sets: tuple[MapSet, ...],
        files: tuple[Path, ...],
        warnings: tuple[str, ...],
    ) -> Batches:
        materials = table.materials()
        matte = (materials["surface"][:, 0] <= 0.0) & (materials["surface"][:, 1] >= MATTE_ROUGHNESS)
        looked_rows = np.array([bool(look) for _, look in table.rows], dtype=bool)
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
            moving, texture, maps, kind, unlit, colored, _ = key
            rows = np.unique(np.concatenate([v["material"] for v in piles[key].vertices]))
            material = int(rows[0]) if len(rows) == 1 else -1
            shiny = not matte[rows].all() or (maps >= 0 and map_sets[maps][0] is not None)
            glossy, looked = not unlit and shiny, bool(looked_rows[rows].any())
            if batches and settings(batches[-1]) == (moving, texture, maps, kind, unlit, colored):
                last = batches.pop()
                first, material = last.first_chunk, material if material == last.material else -1
                glossy, looked = glossy or last.glossy, looked or last.looked
            span = (first, self._chunk_count)
            batches.append(Batch(texture, kind, maps, unlit, glossy, looked, colored, moving, material, *span))
        if self._index_count >= 2**31:
            raise ConfigError(
                f"the scene has {self._triangles} triangles, at most {2**31 // 6} can be drawn; simplify its meshes"
            )
        c = self._chunks
        return Batches(
            vertices=np.concatenate(self._vertices) if self._vertices else np.zeros(0, dtype=VERTEX),
            indices=_joined(self._indices, np.uint32),
            materials=materials,
            looks=table.looks(),
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
            triangles=self._triangles,
            files=files,
            warnings=warnings,
        )

    def _add(self, key: _Key, pile: _Pile, fixed: NDArray[np.bool_] | None) -> None:
        """Appends the chunks of one pile, all levels; what equals an earlier pile but for label, material and link uses its triangles."""
        _, texture, maps, kind, _, colored, link = key
        vertices = np.concatenate(pile.vertices)
        placement = np.zeros(1, dtype=PLACEMENT)
        if link:
            placement["link"] = link
            for name in ("label", "material"):
                if (vertices[name] == vertices[name][0]).all():
                    placement[name] = vertices[name][0]
                    vertices[name] = 0
        triangles = _wound(vertices, np.concatenate(pile.triangles))
        size = CHUNK_TRIANGLES
        if kind == "blend":
            size = min(max(len(triangles) // BLEND_CHUNKS, 1), size)
        coarser, textured = self._coarser and kind != "blend", max(texture, maps) >= 0
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


def settings(batch: Batch) -> tuple[bool, int, int, Kind, bool, bool]:
    """Returns what batches have in common that may be drawn as one."""
    return batch.moving, batch.texture, batch.maps, batch.kind, batch.unlit, batch.colored


def _wound(vertices: NDArray[np.void], triangles: I64) -> I64:
    """Returns triangles whose corners go round as their normals say, counter-clockwise seen from outside."""
    a, b, c = (vertices["position"][triangles[:, k]] for k in range(3))
    outward = vertices["normal"][triangles].sum(axis=1, dtype=np.int64)
    wrong = np.einsum("fk,fk->f", np.cross(b - a, c - a), outward) < 0.0
    triangles[wrong] = triangles[wrong][:, ::-1]
    return triangles


def _joined(pieces: Sequence[NDArray[Any]], kind: type[np.generic]) -> NDArray[Any]:
    return np.concatenate(pieces).astype(kind) if pieces else np.zeros(0, dtype=kind)


def _shared_places(piles: dict[_Key, _Pile]) -> dict[_Key, NDArray[np.bool_]]:
    """Returns for each pile which vertices lie where another pile of its link has one too: moving them would open cracks."""
    shared: dict[_Key, NDArray[np.bool_]] = {}
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


def _by_link(piles: dict[_Key, _Pile]) -> Iterator[list[_Key]]:
    for link in sorted({key[-1] for key in piles}):
        yield [key for key in piles if key[-1] == link]
