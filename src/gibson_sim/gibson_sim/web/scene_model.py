"""A scene for rendering in a browser: a few vertex arrays in the frames of their links, and textures as image files."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import GibsonSimError
from gibson_sim.formats.load_mesh import MeshLoader, mesh_folders
from gibson_sim.formats.mesh import MeshPart, TextureSource, apply, transform_normals
from gibson_sim.geometry.transforms import matrix_from_pose
from gibson_sim.geometry.triangle_meshes import simplified_triangles
from gibson_sim.scenes.spec import DrawnScene
from gibson_sim.types import SceneState

MAX_TRIANGLES = 400_000
"""Largest number of triangles of a model; the meshes of a larger scene are simplified in proportion."""
_TEXTURE_PX = 1024
"""Largest width or height of a texture."""
_VERTEX = np.dtype([("position", "<f4", 3), ("uv", "<f4", 2), ("normal", "i1", 4), ("color", "u1", 4)])
_POSES = struct.Struct("<BBHd")
"""Header of a pose message: kind (2 = poses), 0, 0, stamp in seconds; seven float32 for each link follow: x, y, z, quaternion x, y, z, w."""


@dataclass(frozen=True, slots=True)
class SceneModel:
    """The files that a page downloads."""

    description: bytes
    """JSON: ``batches`` (link, -1 = the world; texture, -1 = none; unlit; blend; first and count of indices), ``vertices`` and ``indices`` (counts),
    ``textures`` (their number), ``links``, ``background`` (sRGB, 0 to 1)."""
    arrays: bytes
    """Vertices (28 bytes each: position, uv, normal, colour), then indices (uint32)."""
    textures: tuple[bytes, ...]
    """JPEG or PNG files."""


@dataclass
class _Batch:
    """Triangles drawn by one draw call."""

    vertices: list[NDArray[np.void]] = field(default_factory=list)
    triangles: list[NDArray[np.int64]] = field(default_factory=list)
    count: int = 0


def scene_model(scene: DrawnScene, warn: Callable[[str], None] = lambda _: None) -> SceneModel:
    """Returns the model of a scene; unreadable meshes are omitted with a warning."""
    loader = MeshLoader(mesh_folders([visual.shape for visual in scene.visuals]))
    links = {name: k for k, name in enumerate(scene.links)}
    textures: dict[int, int] = {}
    files: list[bytes] = []
    batches: dict[tuple[int, int, bool, bool], _Batch] = {}
    parts: list[tuple[int, NDArray[np.float64], tuple[float, ...] | None, MeshPart]] = []
    for visual in scene.visuals:
        try:
            mesh = loader.shape(visual.shape)
        except GibsonSimError as error:
            warn(str(error))
            continue
        link, matrix = links.get(visual.link, -1), matrix_from_pose(visual.pose)
        parts += [(link, matrix, visual.color, part) for part in mesh.parts]
    total = sum(len(part.triangles) for *_, part in parts)
    share = min(1.0, MAX_TRIANGLES / max(1, total))
    for link, matrix, color, part in parts:
        texture = part.material.texture if color is None else None
        number = -1
        if texture is not None:
            if id(texture) not in textures:
                textures[id(texture)] = len(files)
                files.append(_encoded(texture))
            number = textures[id(texture)]
        alpha = color[3] if color is not None else part.material.base_color[3]
        blend = alpha < 1.0 or part.material.alpha_mode == "blend"
        triangles = part.triangles.astype(np.int64)
        if share < 1.0:
            triangles = simplified_triangles(part.vertices, triangles, least=max(12, int(share * len(triangles))))
        # The page has no light maps: its own light shows the shapes of such surfaces.
        unlit = part.material.unlit and part.material.light_map is None
        batch = batches.setdefault((link, number, unlit, blend), _Batch())
        batch.triangles.append(triangles + batch.count)
        batch.vertices.append(_vertices(part, matrix, color))
        batch.count += len(part.vertices)
    return _packed(scene, batches, files)


def poses_message(state: SceneState) -> bytes:
    """Returns the WebSocket message with the poses of all links at a state."""
    rows = np.hstack([state.positions, state.quats_xyzw]).astype("<f4")
    return _POSES.pack(2, 0, 0, state.stamp_ns / 1e9) + rows.tobytes()


def _vertices(part: MeshPart, matrix: NDArray[np.float64], color: tuple[float, ...] | None) -> NDArray[np.void]:
    vertices = np.zeros(len(part.vertices), dtype=_VERTEX)
    vertices["position"] = apply(matrix, part.vertices)
    if part.uvs is not None:
        vertices["uv"] = part.uvs
    vertices["normal"][:, :3] = np.round(transform_normals(matrix, part.normals) * 127.0)
    base = np.array(part.material.base_color if color is None else color, dtype=np.float64)
    vertices["color"] = np.round(np.clip(base, 0.0, 1.0) * 255.0)
    if color is None and part.colors is not None and part.material.colored:
        channels = part.colors.shape[1]
        vertices["color"][:, :channels] = np.round(part.colors * np.clip(base[:channels], 0.0, 1.0))
    return vertices


def _encoded(texture: TextureSource) -> bytes:
    """Returns a texture as a JPEG or PNG file, scaled down to ``_TEXTURE_PX``."""
    pixels = texture.pixels
    scale = _TEXTURE_PX / max(pixels.shape[:2])
    if scale < 1.0:
        size = (max(1, round(pixels.shape[1] * scale)), max(1, round(pixels.shape[0] * scale)))
        pixels = np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    has_alpha = pixels.shape[2] == 4 and bool((pixels[:, :, 3] < 255).any())
    order = cv2.COLOR_RGBA2BGRA if has_alpha else cv2.COLOR_RGB2BGR
    bgr = cv2.cvtColor(np.ascontiguousarray(pixels if has_alpha else pixels[:, :, :3]), order)
    return bytes(cv2.imencode(".png" if has_alpha else ".jpg", bgr, [] if has_alpha else [cv2.IMWRITE_JPEG_QUALITY, 88])[1])


def _packed(scene: DrawnScene, batches: dict[tuple[int, int, bool, bool], _Batch], files: list[bytes]) -> SceneModel:
    batch_entries, vertices, indices, first_vertex, first_index = [], [], [], 0, 0
    for (link, texture, unlit, blend), batch in sorted(batches.items(), key=lambda item: item[0][3]):
        triangles = np.concatenate(batch.triangles) + first_vertex
        batch_entries.append(
            {"link": link, "texture": texture, "unlit": unlit, "blend": blend, "first": first_index, "count": triangles.size}
        )
        vertices += batch.vertices
        indices.append(triangles.astype("<u4").ravel())
        first_vertex += batch.count
        first_index += triangles.size
    description = {
        "batches": batch_entries, "vertices": first_vertex, "indices": first_index, "textures": len(files), "links": list(scene.links),
        "background": list(scene.light.background),
    }  # fmt: skip
    arrays = b"".join([v.tobytes() for v in vertices] + [i.tobytes() for i in indices])
    return SceneModel(json.dumps(description).encode(), arrays, tuple(files))
