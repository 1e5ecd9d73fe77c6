"""All triangles of a scene in a few large arrays for the GPU; ``building`` builds them. No OpenGL.

A *batch* is drawn with one set of settings: texture, alpha mode, shading; moving and static triangles are in different batches. A batch
consists of *clusters*: up to 256 neighbouring triangles of one link with a bounding box, at several levels of detail (``lod.clusters``).
Static triangles are in the world frame (link number 0), all others in the frame of their link.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from gibson_sim.description.shapes import Shape
from gibson_sim.formats.mesh import LightMapSource, Mesh, TextureSource

Loader = Callable[[Shape], Mesh]
Progress = Callable[[str, float], None]
"""Called with the current stage and its progress, 0 to 1."""
AlphaMode = Literal["opaque", "mask", "blend"]
"""glTF's ``alphaMode``."""
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

VERTEX = np.dtype([("position", "<f4", 3), ("normal", "<i2", 3), ("material", "<u2"), ("uv", "<f4", 2), ("label", "<u2", 2)])
EXTRA_FIELDS: tuple[tuple[Any, ...], ...] = (("color", "<u2", 4), ("light_uv", "<u2", 2))
"""Fields of vertices that few scenes need, in this order after those of ``VERTEX``. ``color``: linear red, green, blue and alpha, where vertex
colours multiply textures; without textures the colours are in ``uv``. ``light_uv``: coordinates in the light map, 65535 = 1."""
PLACEMENT = np.dtype([("link", "<u4"), ("label", "<u2", 2), ("material", "<u4")])
"""An instance of shared triangles: its link, and offsets that are added to the label and material numbers of the vertices."""
MATERIAL = np.dtype([("color", "<f4", 4), ("surface", "<f4", 4), ("emission", "<f4", 4), ("maps", "<f4", 4)])
"""``color``: linear base colour and alpha. ``surface``: metalness, roughness, smallest opaque alpha, 1 = unlit. ``emission``: linear
colour and 0. ``maps``: normal scale, occlusion strength, weights of the metalness map and of the roughness map."""
APPEARANCE = np.dtype([("tint", "<f4", (3, 4)), ("first", "<f4", 4), ("second", "<f4", 4)])
"""Memory layout of ``Appearance`` in appearances.glsl."""
PLAIN_APPEARANCE = (*np.eye(3, 4).ravel().tolist(), 0.0, 0.0, 0.0, -1.0, 1.0, 1.0, 1.0, 1.0)
"""The identity appearance; the fourth component of ``first`` is the layer of the pattern, -1 = none."""
MapSet = tuple[TextureSource | None, TextureSource | None, TextureSource | None, TextureSource | None]
"""Material maps: metallic-roughness, normals, occlusion, emission."""
LightMap = tuple[LightMapSource, float]
"""A light map and its intensity, ``Material.light_intensity``."""
MAX_LABEL = 2**16 - 1
"""Largest number of a semantic class, an instance or a material."""


@dataclass(frozen=True, slots=True)
class Batch:
    """Clusters that are drawn with the same settings."""

    texture: int
    """Index in ``SceneGeometry.textures``; -1 = none."""
    alpha_mode: AlphaMode
    maps: int
    """Index in ``SceneGeometry.map_sets``; -1 = none."""
    light_map: int
    """Index in ``SceneGeometry.light_maps``; -1 = none."""
    unlit: bool
    """Whether its materials are unlit."""
    glossy: bool
    """Whether any of its materials has specular highlights."""
    has_appearance: bool
    """Whether any of its materials has a tint or a pattern."""
    colored: bool
    """Whether its vertices have colours: in ``uv``, or in ``color`` if it has a texture or maps too."""
    moving: bool
    """Whether its clusters belong to links, not to the world."""
    closed: bool
    """Whether all its triangles belong to closed surfaces, whose back faces are never visible from outside."""
    material: int
    """Index in ``SceneGeometry.materials`` if all its triangles share one material, else -1."""
    first_cluster: int
    end_cluster: int


@dataclass(frozen=True, slots=True, eq=False)
class SceneGeometry:
    """All triangles of a scene."""

    vertices: NDArray[np.void]
    """(V,) of ``VERTEX``, with those of ``EXTRA_FIELDS`` that any batch needs."""
    indices: NDArray[np.uint32]
    """(3 F,), rows in ``vertices``."""
    materials: NDArray[np.void]
    """(M,) of ``MATERIAL``."""
    appearances: NDArray[np.void]
    """(M,) of ``APPEARANCE`` if any batch ``has_appearance``; else (0,)."""
    patterns: NDArray[np.uint8]
    """(L, S, S, 3), sRGB: layers referenced by ``appearances``."""
    map_sets: tuple[MapSet, ...]
    light_maps: tuple[LightMap, ...]
    batches: tuple[Batch, ...]
    textures: tuple[TextureSource, ...]
    cluster_first: NDArray[np.uint32]
    """(C,), offset in ``indices``."""
    cluster_count: NDArray[np.uint32]
    """(C,), number of indices."""
    cluster_box: F64
    """(C, 6), centre and half extents, metres, frame of the link."""
    cluster_link: I64
    """(C,), 0 = the world, else 1 + index in ``links``."""
    cluster_placement: NDArray[np.uint32]
    """(C,), row in ``placements``."""
    placements: NDArray[np.void]
    """(P,) of ``PLACEMENT``; the first one belongs to all static clusters."""
    cluster_group: I64
    """(C,), as ``Clusters.group``, with numbers unique in the scene."""
    cluster_next_group: I64
    """(C,), as ``Clusters.next_group``."""
    group_error: F64
    """(G,), geometric error, metres."""
    group_box: F64
    """(G, 6), centre and half extents, metres, frame of the link."""
    group_link: I64
    """(G,), as ``cluster_link``."""
    closed_box: F64
    """(S, 6), boxes of closed surfaces: centre and half extents, metres, frame of the link."""
    closed_link: I64
    """(S,), as ``cluster_link``."""
    triangles: int
    """Number of triangles at the finest level."""
    files: tuple[Path, ...]
    """Files read to build it."""
    warnings: tuple[str, ...]


def vertex_dtype(extra: Iterable[str]) -> np.dtype[np.void]:
    """Returns ``VERTEX`` with the named fields of ``EXTRA_FIELDS``."""
    names = set(extra)
    return np.dtype([*VERTEX.descr, *(f for f in EXTRA_FIELDS if f[0] in names)])


def joined_dtype(dtypes: Iterable[np.dtype[np.void]]) -> np.dtype[np.void]:
    """Returns the type of vertices with all fields that any of these types has."""
    return vertex_dtype(name for dtype in dtypes for name in dtype.names or ())


def with_dtype(vertices: NDArray[np.void], dtype: np.dtype[np.void]) -> NDArray[np.void]:
    """Returns vertices with more fields of ``EXTRA_FIELDS``; new fields are 0, and are not read."""
    if vertices.dtype == dtype:
        return vertices
    out = np.zeros(len(vertices), dtype=dtype)
    for name in vertices.dtype.names or ():
        out[name] = vertices[name]
    return out


def settings(batch: Batch) -> tuple[bool, int, int, int, AlphaMode, bool, bool, bool]:
    """Returns the settings of a batch; batches with equal settings may be merged."""
    return batch.moving, batch.texture, batch.maps, batch.light_map, batch.alpha_mode, batch.unlit, batch.colored, batch.closed
