"""All triangles of a scene in few arrays that a GPU draws quickly; ``building`` makes them. No OpenGL here.

Triangles that share texture, transparency and shading form a batch, moving ones apart from static ones; batches consist of chunks:
neighbouring triangles of one link, each with its box, at several levels of detail (``clusters``). Static triangles stand in the
world frame (link number 0), others in the frame of their link.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gibson_sim.description.shapes import Shape
from gibson_sim.formats.mesh import Mesh, TextureSource

Loader = Callable[[Shape], Mesh]
Progress = Callable[[str, float], None]
"""Called with what is done and how much of it, 0 to 1."""
Kind = Literal["opaque", "mask", "blend"]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

VERTEX = np.dtype([("position", "<f4", 3), ("normal", "<i2", 3), ("material", "<u2"), ("uv", "<f4", 2), ("label", "<u2", 2)])
PLACEMENT = np.dtype([("link", "<u4"), ("label", "<u2", 2), ("material", "<u4")])
"""One use of triangles that several bodies share: link, and what is added to the label and material numbers of the vertices."""
MATERIAL = np.dtype([("color", "<f4", 4), ("surface", "<f4", 4), ("glow", "<f4", 4), ("maps", "<f4", 4)])
"""Base colour (linear) and alpha; metallic, roughness, alpha below which nothing is solid, 1 = unlit; emission; and of the further
textures the scale of normals, the strength of occlusion, and how much they say of metallic and of roughness."""
APPEARANCE = np.dtype([("tint", "<f4", (3, 4)), ("first", "<f4", 4), ("second", "<f4", 4)])
"""``Appearance`` of appearances.glsl."""
PLAIN_APPEARANCE = (*np.eye(3, 4).ravel().tolist(), 0.0, 0.0, 0.0, -1.0, 1.0, 1.0, 1.0, 1.0)
"""One that changes nothing; the fourth number of ``first`` is the layer of the pattern, -1 = none."""
MapSet = tuple[TextureSource | None, TextureSource | None, TextureSource | None, TextureSource | None]
"""Metallic-roughness, normals, occlusion, emission."""
MAX_LABEL = 2**16 - 1
"""Greatest number of a semantic class, an instance or a material."""


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
    has_appearance: bool
    """Some of it wears a tint or a pattern."""
    colored: bool
    """Its vertices have colours, in the place of texture coordinates."""
    moving: bool
    """Its chunks belong to links, not to the world."""
    closed: bool
    """Only closed solids: what of them is turned away is never seen from outside."""
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
    appearances: NDArray[np.void]
    """(M,) of ``APPEARANCE``, where any batch is ``looked``; else (0,)."""
    patterns: NDArray[np.uint8]
    """(L, S, S, 3), sRGB: layers that appearances name."""
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
    solid_box: F64
    """(S, 6), of closed solids, centre and half the size, metres, frame of the link."""
    solid_link: I64
    """(S,), as ``chunk_link``."""
    triangles: int
    """Number of triangles at the finest level."""
    files: tuple[Path, ...]
    """What was read."""
    warnings: tuple[str, ...]


def settings(batch: Batch) -> tuple[bool, int, int, Kind, bool, bool, bool]:
    """Returns what batches have in common that may be drawn as one."""
    return batch.moving, batch.texture, batch.maps, batch.kind, batch.unlit, batch.colored, batch.closed
