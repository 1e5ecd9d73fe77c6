"""Merges all visuals of a scene into few arrays that a GPU draws quickly, and says which pieces a camera can see. No OpenGL here.

Triangles that share link, texture and kind of transparency form a batch; batches are cut into chunks of neighbouring triangles,
each with its box, so that what lies outside the image is skipped and what is near is drawn first. Static triangles stand in the
world frame (link number 0), others in the frame of their link.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import ConfigError, GibsonSimError
from gibson_sim.geometry.transforms import matrix_from_pose, transform_points
from gibson_sim.robots.spec import Shape, VisualSpec
from gibson_sim.scenes.mesh_types import Material, Mesh, MeshPart, TextureSource
from gibson_sim.types import Rgba

Loader = Callable[[Shape], Mesh]
Kind = Literal["opaque", "mask", "blend"]
F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

VERTEX = np.dtype(
    [("position", "<f4", 3), ("normal", "<f4", 3), ("uv", "<f4", 2), ("color", "<f2", 4), ("surface", "u1", 4), ("label", "<u2", 2)]
)  # fmt: skip
CHUNK_TRIANGLES = 512
BLEND_CHUNKS = 2048
"""Translucent batches are cut into about this many chunks or single triangles, since they are drawn in order of their distance."""
MAX_LABEL = 2**16 - 1
"""Greatest number of a semantic class or an instance."""
SOLID_ALPHA = 0.9
"""Where a blended material has at least this alpha it is drawn as solid, so that it also has a depth."""


@dataclass(frozen=True, slots=True)
class Batch:
    """Chunks that are drawn with the same settings."""

    link: int
    """0 = the world, else 1 + index in ``links``."""
    texture: int
    """Index in ``Batches.textures``; -1 = none."""
    kind: Kind
    first_chunk: int
    end_chunk: int


@dataclass(frozen=True, slots=True, eq=False)
class Batches:
    """All triangles of a scene."""

    vertices: NDArray[np.void]
    """(V,) of ``VERTEX``."""
    indices: NDArray[np.uint32]
    """(3 F,), rows of ``vertices``."""
    batches: tuple[Batch, ...]
    textures: tuple[TextureSource, ...]
    chunk_first: NDArray[np.int32]
    """(C,), position in ``indices``."""
    chunk_count: NDArray[np.int32]
    """(C,), how many indices."""
    chunk_centre: F64
    """(C, 3), metres, frame of the link."""
    chunk_half: F64
    """(C, 3), half the size of the box."""
    chunk_link: I64
    """(C,), as ``Batch.link``."""
    warnings: tuple[str, ...]

    @property
    def triangles(self) -> int:
        """Number of triangles."""
        return len(self.indices) // 3


@dataclass(slots=True)
class _Pile:
    """Parts of one batch while they are gathered."""

    vertices: list[NDArray[np.void]] = field(default_factory=list)
    triangles: list[I64] = field(default_factory=list)
    count: int = 0

    def add(self, vertices: NDArray[np.void], triangles: NDArray[np.uint32]) -> None:
        self.vertices.append(vertices)
        self.triangles.append(triangles.astype(np.int64) + self.count)
        self.count += len(vertices)


def build_batches(
    visuals: Sequence[VisualSpec], links: Sequence[str], loader: Loader, labels: Sequence[tuple[int, int]] = ()
) -> Batches:
    """Returns the triangles of all visuals; a visual that cannot be loaded is left out with a warning.

    Args:
        visuals: what to draw.
        links: names of the moving links, in the order of ``SceneState.links``.
        loader: returns the mesh of a shape, or raises a ``GibsonSimError``.
        labels: semantic class and instance of each visual; empty = all 0.
    """
    highest = max((max(label) for label in labels), default=0)
    if highest > MAX_LABEL:
        raise ConfigError(f"the scene has {highest} classes or instances, at most {MAX_LABEL} can be told apart in an image")
    link_numbers = {"": 0, **{name: i + 1 for i, name in enumerate(links)}}
    piles: dict[tuple[int, int, Kind], _Pile] = {}
    textures: dict[int, tuple[int, TextureSource]] = {}
    warnings: list[str] = []
    for visual, label in zip(visuals, labels or [(0, 0)] * len(visuals), strict=True):
        if visual.link not in link_numbers:
            warnings.append(f"visual {visual.name!r}: link {visual.link!r} is not in the scene; it is not drawn")
            continue
        try:
            mesh = loader(visual.shape)
        except GibsonSimError as e:
            warnings.append(f"visual {visual.name!r} is not drawn: {e}")
            continue
        warnings += [w for w in mesh.warnings if w not in warnings]
        for part in mesh.parts:
            material = part.material if visual.color is None else _plain(visual.color)
            texture = material.texture if part.uvs is not None else None
            number = -1 if texture is None else textures.setdefault(id(texture), (len(textures), texture))[0]
            key = (link_numbers[visual.link], number, _kind(material, texture))
            vertices = _vertices(part, material, matrix_from_pose(visual.pose), label)
            piles.setdefault(key, _Pile()).add(vertices, part.triangles)
    return _join(piles, [t for _, t in textures.values()], warnings)


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


def _vertices(part: MeshPart, material: Material, T_link_visual: F64, label: tuple[int, int]) -> NDArray[np.void]:
    out = np.zeros(len(part.vertices), dtype=VERTEX)
    out["position"] = transform_points(T_link_visual, part.vertices)
    out["normal"] = part.normals @ T_link_visual[:3, :3].T
    if part.uvs is not None:
        out["uv"] = part.uvs
    linear = [linear_from_srgb(c) for c in material.base_color[:3]]
    out["color"] = (*linear, material.base_color[3])
    out["surface"] = (255 if material.unlit else 0, round(min(max(_solid_alpha(material), 0.0), 1.0) * 255.0), 0, 0)
    out["label"] = label
    return out


def linear_from_srgb(value: float) -> float:
    """Returns the linear value, 0 to 1, of an sRGB one."""
    v = min(max(value, 0.0), 1.0)
    return v / 12.92 if v <= 0.04045 else float(((v + 0.055) / 1.055) ** 2.4)


def _join(piles: dict[tuple[int, int, Kind], _Pile], textures: list[TextureSource], warnings: list[str]) -> Batches:
    vertices: list[NDArray[np.void]] = []
    indices: list[I64] = []
    batches: list[Batch] = []
    boxes: list[tuple[int, int, F64, F64, int]] = []
    first = base = 0
    for (link, texture, kind), pile in piles.items():
        triangles, ends, pile_vertices = _chunks(np.concatenate(pile.vertices), np.concatenate(pile.triangles), kind)
        start = 0
        batches.append(Batch(link, texture, kind, len(boxes), len(boxes) + len(ends)))
        for end in ends:
            corners = pile_vertices["position"][triangles[start:end].ravel()]
            low, high = corners.min(axis=0).astype(np.float64), corners.max(axis=0).astype(np.float64)
            boxes.append((first + 3 * start, 3 * (end - start), (low + high) / 2, (high - low) / 2, link))
            start = end
        vertices.append(pile_vertices)
        indices.append(triangles.ravel() + base)
        first += triangles.size
        base += len(pile_vertices)
    if first >= 2**31:
        raise ConfigError(f"the scene has {first // 3} triangles, at most {2**31 // 3} can be drawn; simplify its meshes")
    return Batches(
        vertices=np.concatenate(vertices) if vertices else np.zeros(0, dtype=VERTEX),
        indices=np.concatenate(indices).astype(np.uint32) if indices else np.zeros(0, dtype=np.uint32),
        batches=tuple(batches),
        textures=tuple(textures),
        chunk_first=np.array([b[0] for b in boxes], dtype=np.int32),
        chunk_count=np.array([b[1] for b in boxes], dtype=np.int32),
        chunk_centre=np.array([b[2] for b in boxes], dtype=np.float64).reshape(-1, 3),
        chunk_half=np.array([b[3] for b in boxes], dtype=np.float64).reshape(-1, 3),
        chunk_link=np.array([b[4] for b in boxes], dtype=np.int64),
        warnings=tuple(warnings),
    )


def _chunks(vertices: NDArray[np.void], triangles: I64, kind: Kind) -> tuple[I64, list[int], NDArray[np.void]]:
    """Returns the triangles ordered so that neighbours in space are neighbours in memory, where chunks end, and the vertices."""
    size = CHUNK_TRIANGLES if kind != "blend" else min(max(len(triangles) // BLEND_CHUNKS, 1), CHUNK_TRIANGLES)
    centroids = vertices["position"][triangles].mean(axis=1, dtype=np.float64)
    codes = _morton(centroids)
    leaves: list[I64] = []
    stack = [np.argsort(codes, kind="stable")]
    while stack:
        rows = stack.pop()
        if len(rows) <= size:
            leaves.append(rows)
            continue
        points = centroids[rows]
        axis = int(np.argmax(np.ptp(points, axis=0)))
        # Equal halves of whole chunks; a stable sort keeps equal coordinates in Morton order.
        half = size * ((len(rows) + 2 * size - 1) // (2 * size))
        upper = np.zeros(len(rows), dtype=bool)
        upper[np.argsort(points[:, axis], kind="stable")[half:]] = True
        stack += [rows[upper], rows[~upper]]
    triangles = triangles[np.concatenate(leaves)]
    # Vertices in the order of their first use: the vertex stage of a software renderer lives on memory locality.
    used, first, inverse = np.unique(triangles, return_index=True, return_inverse=True)
    order = np.argsort(first, kind="stable")
    new_number = np.empty(len(used), dtype=np.int64)
    new_number[order] = np.arange(len(used))
    ends = np.cumsum([len(leaf) for leaf in leaves]).tolist()
    return new_number[inverse.reshape(triangles.shape)], ends, vertices[used[order]]


def _morton(points: F64) -> I64:
    """Returns positions along a Z-order curve, (N,), of points (N, 3)."""
    low = points.min(axis=0)
    size = max(float(np.ptp(points, axis=0).max()), 1e-9)
    cells = ((points - low) / size * 1023.0).astype(np.int64)
    code = np.zeros(len(points), dtype=np.int64)
    for bit in range(10):
        for axis in range(3):
            code |= ((cells[:, axis] >> bit) & 1) << (3 * bit + axis)
    return code


def visible_chunks(batches: Batches, planes: F64, T_camera_links: F64, eyes: F64) -> tuple[NDArray[np.bool_], F64]:
    """Returns which chunks may be in the image, (C,), and how far each box is from the eye, (C,), metres.

    Args:
        batches: the scene.
        planes: (P, 4), optical frame: a point x is inside where ``planes @ (x, 1) >= 0`` for all.
        T_camera_links: (L + 1, 4, 4): optical frame from the world, then from each link.
        eyes: (L + 1, 3): the eye in the world, then in each link.
    """
    link_planes = np.einsum("pk,lkj->lpj", planes, T_camera_links)[batches.chunk_link]
    centre, half = batches.chunk_centre, batches.chunk_half
    nearest = np.einsum("cpk,ck->cp", link_planes[:, :, :3], centre) + link_planes[:, :, 3]
    reach = np.einsum("cpk,ck->cp", np.abs(link_planes[:, :, :3]), half)
    gap = np.maximum(np.abs(eyes[batches.chunk_link] - centre) - half, 0.0)
    return (nearest + reach >= 0.0).all(axis=1), np.sqrt(np.einsum("ck,ck->c", gap, gap))
