"""Merges all visuals of a scene into ``SceneGeometry``. No OpenGL."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gibson_sim.description.shapes import Shape, VisualSpec
from gibson_sim.errors import ConfigError, GibsonSimError
from gibson_sim.formats.mesh import Material, MeshPart, TextureSource
from gibson_sim.geometry.colours import linear16_from_srgb8
from gibson_sim.geometry.transforms import matrix_from_pose, transform_points
from gibson_sim.render.batching.assembly import GeometryAssembler, Submesh, SubmeshKey
from gibson_sim.render.batching.material_table import MaterialTable, opaque_alpha
from gibson_sim.render.batching.scene_geometry import (
    MAX_LABEL,
    VERTEX,
    AlphaMode,
    LightMap,
    Loader,
    MapSet,
    Progress,
    SceneGeometry,
    vertex_dtype,
    with_dtype,
)
from gibson_sim.render.culling.closed_surfaces import ClosedSurfaces, find_closed_surfaces, transformed_boxes
from gibson_sim.types import Rgba

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]


def build_geometry(
    visuals: Sequence[VisualSpec],
    links: Sequence[str],
    loader: Loader,
    labels: Sequence[tuple[int, int]] = (),
    *,
    levels_of_detail: bool = True,
    progress: Progress | None = None,
) -> SceneGeometry:
    """Returns the triangles of all visuals; a visual that cannot be loaded is omitted with a warning.

    Args:
        visuals: visuals to draw.
        links: names of the moving links, in the order of ``SceneState.links``.
        loader: returns the mesh of a shape, or raises a ``GibsonSimError``.
        labels: semantic class and instance of each visual; empty = all 0.
        levels_of_detail: build levels of detail.
        progress: called with the current stage and its progress, 0 to 1.

    Raises:
        ConfigError: there are more classes, instances or materials than numbers for them.
    """
    highest = max((max(label) for label in labels), default=0)
    if highest > MAX_LABEL:
        raise ConfigError(f"the scene has {highest} classes or instances, an image can distinguish at most {MAX_LABEL}")
    progress = progress or (lambda what, part: None)
    link_numbers = {"": 0, **{name: i + 1 for i, name in enumerate(links)}}
    submeshes: dict[SubmeshKey, Submesh] = {}
    textures: dict[int, tuple[int, TextureSource]] = {}
    map_sets: dict[tuple[int, ...], tuple[int, MapSet]] = {}
    light_maps: dict[tuple[int, float], tuple[int, LightMap]] = {}
    files: dict[Path, None] = {}
    warnings: list[str] = []
    known_closed: dict[tuple[Shape, tuple[bool, ...]], ClosedSurfaces] = {}
    closed_boxes, closed_links = [np.zeros((0, 6))], [np.zeros(0, dtype=np.int64)]
    table = MaterialTable([v.appearance for v in visuals if v.appearance is not None], warnings.append)
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
        if visual.appearance is not None and visual.appearance.pattern is not None and visual.appearance.pattern.image:
            files[Path(visual.appearance.pattern.image)] = None
        link, T_link_visual = link_numbers[visual.link], matrix_from_pose(visual.pose)
        materials = [part.material if visual.color is None else _plain(visual.color) for part in mesh.parts]
        drawn = [material.texture if part.uvs is not None else None for part, material in zip(mesh.parts, materials, strict=True)]
        alpha_modes = tuple(map(_alpha_mode, materials, drawn, (part.colors for part in mesh.parts)))
        closed_key = (visual.shape, tuple(mode == "opaque" for mode in alpha_modes))
        if closed_key not in known_closed:
            known_closed[closed_key] = find_closed_surfaces(mesh.parts, closed_key[1])
        surfaces = known_closed[closed_key]
        closed_boxes.append(transformed_boxes(surfaces.boxes, T_link_visual))
        closed_links.append(np.full(len(surfaces.boxes), link))
        for part, material, texture, alpha_mode, is_closed in zip(
            mesh.parts, materials, drawn, alpha_modes, surfaces.triangles, strict=True
        ):
            number = -1 if texture is None else textures.setdefault(id(texture), (len(textures), texture))[0]
            maps = -1
            if part.uvs is not None and material.has_maps:
                map_set = _map_set(material)
                maps = map_sets.setdefault(tuple(map(id, map_set)), (len(map_sets), map_set))[0]
            light = -1
            if part.light_uvs is not None and material.light_map is not None:
                light_map = (material.light_map, material.light_intensity)
                light = light_maps.setdefault((id(material.light_map), material.light_intensity), (len(light_maps), light_map))[0]
            row = table.row(material if part.uvs is not None else replace(material, texture=None), visual.appearance)
            vertices = _vertices(part, row, T_link_visual, label)
            colored = material.colored and part.colors is not None
            colored_beside_uvs = colored and max(number, maps) >= 0
            extra = [name for name, on in (("color", colored_beside_uvs), ("light_uv", light >= 0)) if on]
            vertices = with_dtype(vertices, vertex_dtype(extra))
            if light >= 0 and part.light_uvs is not None:
                vertices["light_uv"] = np.rint(np.clip(part.light_uvs, 0.0, 1.0) * 65535.0)
            if colored_beside_uvs:
                vertices["color"] = _linear_colors(part.colors)
            elif colored:
                vertices["uv"] = _linear_colors(part.colors).view("<f4")
            for closed in (False, True):
                triangles = part.triangles[is_closed == closed]
                if len(triangles):
                    key = (link > 0, number, maps, light, alpha_mode, material.unlit, colored, closed, link)
                    submeshes.setdefault(key, Submesh()).add(*_without_unused_vertices(vertices, triangles))
    progress("reading meshes", 1.0)
    if len(table.rows) > MAX_LABEL:
        raise ConfigError(f"the scene has {len(table.rows)} different materials, at most {MAX_LABEL} can be drawn")
    return GeometryAssembler(levels_of_detail, progress).assemble(
        submeshes,
        table,
        tuple(t for _, t in textures.values()),
        tuple(m for _, m in map_sets.values()),
        tuple(m for _, m in light_maps.values()),
        (np.concatenate(closed_boxes), np.concatenate(closed_links)),
        tuple(files),
        tuple(warnings),
    )


def _without_unused_vertices(
    vertices: NDArray[np.void], triangles: NDArray[np.uint32]
) -> tuple[NDArray[np.void], NDArray[np.uint32]]:
    """Returns vertices and triangles without unreferenced vertices."""
    used = np.zeros(len(vertices), dtype=bool)
    used[triangles] = True
    if used.all():
        return vertices, triangles
    return vertices[used], (np.cumsum(used, dtype=np.uint32) - np.uint32(1))[triangles]


def _plain(color: Rgba) -> Material:
    return Material(base_color=color, alpha_mode="blend" if color[3] < 1.0 else "opaque")


def _alpha_mode(material: Material, texture: TextureSource | None, colors: NDArray[np.uint8] | None) -> AlphaMode:
    """Returns the alpha mode to draw a material with.

    Files often request blending for fully opaque materials, which would take time and lose the depth.
    """
    if material.alpha_mode == "opaque":
        return "opaque"
    lowest = material.base_color[3]
    if texture is not None and texture.pixels.shape[2] == 4:
        lowest *= float(texture.pixels[:, :, 3].min()) / 255.0
    if material.colored and colors is not None and colors.shape[1] == 4:
        lowest *= float(colors[:, 3].min()) / 255.0
    if lowest >= opaque_alpha(material):
        return "opaque"
    return "mask" if material.alpha_mode == "mask" else "blend"


def _map_set(material: Material) -> MapSet:
    return (material.metallic_roughness_texture, material.normal_texture, material.occlusion_texture, material.emissive_texture)


def _vertices(part: MeshPart, material: int, T_link_visual: F64, label: tuple[int, int]) -> NDArray[np.void]:
    out = np.zeros(len(part.vertices), dtype=VERTEX)
    out["position"] = transform_points(T_link_visual, part.vertices)
    out["normal"] = np.rint(np.clip(part.normals @ T_link_visual[:3, :3].T, -1.0, 1.0) * 32767.0)
    if part.uvs is not None:
        out["uv"] = part.uvs
    out["material"] = min(material, MAX_LABEL)
    out["label"] = label
    return out


def _linear_colors(colors: NDArray[np.uint8] | None) -> NDArray[np.uint16]:
    """Returns ``MeshPart.colors`` as linear red, green, blue and alpha, (V, 4), 0 to 65535."""
    assert colors is not None
    out = np.full((len(colors), 4), 65535, dtype="<u2")
    out[:, :3] = linear16_from_srgb8(colors[:, :3])
    if colors.shape[1] == 4:
        out[:, 3] = colors[:, 3].astype(np.uint16) * np.uint16(257)
    return out
