"""Describes a scene for Blender: meshes and materials of all visuals, the links that they are fixed to, light, and the plan of a generated scene.

The baked textures of a generated scene are not used: its walls and furniture are those of the plan. Everything else is exported from its mesh
files, with base colours, textures, roughness, metalness, normals and emission.
"""

from __future__ import annotations

import ast
import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.description.shapes import VisualSpec
from gibson_sim.digests import digest_of
from gibson_sim.errors import GibsonSimError
from gibson_sim.formats.load_mesh import MeshLoader
from gibson_sim.formats.mesh import Material, MeshPart, TextureSource
from gibson_sim.geometry.colours import linear_from_srgb
from gibson_sim.geometry.transforms import matrix_from_pose
from gibson_sim.picture_files import write_picture
from gibson_sim.scenes.spec import DrawnScene, LightSpec
from gibson_sim.writing import replacing, write_file
from gibson_sim_tools import making
from gibson_sim_tools.making.building import QUALITIES, Building, write_plan
from gibson_sim_tools.tracing.plans import check_plan, plan_of_scene

_NOT_SEEN = ("bake.py", "__main__.py", "charts.py")
"""Modules of ``making.blender`` on which a traced picture does not depend."""
_SEEN_BESIDE = ("tiles.py",)
"""Modules of ``making``, outside ``blender``, on which it depends."""


@dataclass(frozen=True, slots=True, eq=False)
class TracedScene:
    """A scene as Blender needs it."""

    name: str
    links: tuple[str, ...]
    """Names of the moving links, in the order of ``SceneState.links``."""
    building: Building | None
    """The plan of a generated scene; None for any other scene."""
    parts: tuple[tuple[MeshPart, Material], ...]
    placements: tuple[tuple[int, int, tuple[float, ...]], ...]
    """(Part, link or -1 = the world, T_link_part by rows) of each placed part."""
    light: LightSpec
    warnings: tuple[str, ...]
    """One line for each visual that was left out."""
    digest: str = ""
    """Hex digest of everything that pictures depend on, other than poses and cameras."""


def traced_scene(scene: DrawnScene) -> TracedScene:
    """Returns a scene for Blender. ``scene``: with local files.

    Raises:
        SceneError: the scene is not what its plan says.
    """
    building = plan_of_scene(scene)
    planned = frozenset[str]() if building is None else check_plan(building, scene)
    numbers = {name: number for number, name in enumerate(scene.links)}
    parts: dict[tuple[int, Any], tuple[int, tuple[MeshPart, Material]]] = {}
    placements: list[tuple[int, int, tuple[float, ...]]] = []
    warnings: list[str] = []
    loader = MeshLoader(None)
    kept: list[Any] = []
    for visual in scene.visuals:
        if not visual.link and visual.name in planned:
            continue
        try:
            mesh = loader.shape(visual.shape)
        except GibsonSimError as error:
            warnings.append(f"visual {visual.name!r} is not traced: {error}")
            continue
        kept.append(mesh)
        T = tuple(matrix_from_pose(visual.pose).ravel().tolist())
        for part in mesh.parts:
            key = (id(part), visual.color)
            number = parts.setdefault(key, (len(parts), (part, _material(visual, part))))[0]
            placements.append((number, numbers.get(visual.link, -1), T))
    found = TracedScene(
        scene.name,
        scene.links,
        building,
        tuple(part for _, part in parts.values()),
        tuple(placements),
        scene.light,
        tuple(warnings),
    )
    return replace(found, digest=_digest(found))


def _material(visual: VisualSpec, part: MeshPart) -> Material:
    if visual.color is None:
        return part.material
    return Material(base_color=visual.color, alpha_mode="blend" if visual.color[3] < 1.0 else "opaque")


def _digest(scene: TracedScene) -> str:
    """Returns a digest of a scene, and of the code that models and traces it."""
    digest = hashlib.sha256(_code_digest().encode())
    digest.update(repr(scene.building).encode())
    for part, material in scene.parts:
        values = {
            **_material_values(material, {}),
            "vertices": part.vertices,
            "normals": part.normals,
            "triangles": part.triangles,
        }
        values |= {"uvs": part.uvs, "colors": part.colors, "images": [t.pixels for t in _textures(material)]}
        digest.update(b"%d" % digest_of(values))
    # The content of images counts, not their place. The environment lights no generated building.
    digest.update(b"%d" % digest_of([scene.placements, asdict(replace(scene.light, backdrop="", environment=""))]))
    for path in (scene.light.backdrop, scene.light.environment if scene.building is None else ""):
        digest.update(Path(path).read_bytes() if path else b"")
    return digest.hexdigest()


def _code_digest() -> str:
    """Returns a digest of the modules on which the pictures depend, without comments and docstrings."""
    digest = hashlib.sha256()
    for path in code_files():
        digest.update(code_text(path.read_text(encoding="utf-8")).encode())
    return digest.hexdigest()


def code_files() -> list[Path]:
    """Returns the modules of ``making`` on which the pictures depend."""
    folder = Path(making.__path__[0])
    blender = folder / "blender"
    found = [path for path in sorted(blender.rglob("*.py")) if "objects" not in path.relative_to(blender).parts]
    return [*(path for path in found if path.name not in _NOT_SEEN), *(folder / name for name in _SEEN_BESIDE)]


def code_text(source: str) -> str:
    """Returns Python code without comments, docstrings and layout: equal texts do the same."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef)):
            node.body = [
                item
                for item in node.body
                if not (isinstance(item, ast.Expr) and isinstance(item.value, ast.Constant) and isinstance(item.value.value, str))
            ] or [ast.Pass()]
    return ast.unparse(tree)


def write_traced_scene(scene: TracedScene, folder: Path) -> None:
    """Writes a scene into a folder, for ``gibson_sim_tools.making.blender.trace``."""
    if scene.building is not None:
        write_plan(folder / "plan.json", scene.building, QUALITIES["normal"])
    files: dict[int, str] = {}
    arrays: dict[str, Any] = {}
    parts = []
    for number, (part, material) in enumerate(scene.parts):
        arrays |= {f"vertices_{number}": part.vertices, f"normals_{number}": part.normals, f"triangles_{number}": part.triangles}
        if part.uvs is not None:
            arrays[f"uvs_{number}"] = part.uvs
        if material.colored and part.colors is not None:
            arrays[f"colors_{number}"] = _vertex_colors(part.colors)
        for texture in _textures(material):
            if id(texture) not in files:
                files[id(texture)] = f"texture_{len(files)}.png"
                code = cv2.COLOR_RGB2BGR if texture.pixels.shape[2] == 3 else cv2.COLOR_RGBA2BGRA
                write_picture(folder / files[id(texture)], cv2.cvtColor(texture.pixels, code), durable=False)
        textured = material if part.uvs is not None else _without_textures(material)
        parts.append({"material": _material_values(textured, files)})
    with replacing(folder / "meshes.npz", durable=False) as draft, draft.open("wb") as archive:
        np.savez(archive, **arrays)
    placements = [{"part": part, "link": link, "matrix": T} for part, link, T in scene.placements]
    light = {**asdict(scene.light), "sun_color": _linear(scene.light.sun_color)}
    light["points"] = [{**asdict(point), "color": _linear(point.color)} for point in scene.light.points]
    write_file(folder / "scene.json", json.dumps({"parts": parts, "placements": placements, "light": light}), durable=False)


def _without_textures(material: Material) -> Material:
    return Material(
        base_color=material.base_color, unlit=material.unlit, alpha_mode=material.alpha_mode, metallic=material.metallic,
        roughness=material.roughness, emissive=material.emissive, colored=material.colored,
    )  # fmt: skip


def _vertex_colors(colors: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Returns linear vertex colours with alpha, (V, 4)."""
    out = np.ones((len(colors), 4), dtype=np.float32)
    out[:, :3] = linear_from_srgb(colors[:, :3].astype(np.float32) / 255)
    return out


def _textures(material: Material) -> Sequence[TextureSource]:
    named = (material.texture, material.metallic_roughness_texture, material.normal_texture, material.emissive_texture)
    return [texture for texture in named if texture is not None]


def _material_values(material: Material, files: dict[int, str]) -> dict[str, Any]:
    """Returns a material as JSON types: colours linear, textures as names of files."""

    def texture(source: TextureSource | None) -> dict[str, Any] | None:
        return None if source is None else {"file": files.get(id(source), ""), "wrap": source.sampling.wrap_u}

    return {
        "color": [*_linear(material.base_color[:3]), material.base_color[3]], "texture": texture(material.texture),
        "unlit": material.unlit, "alpha_mode": material.alpha_mode, "alpha_cutoff": material.alpha_cutoff, "metallic": material.metallic,
        "roughness": material.roughness, "emissive": list(material.emissive), "emissive_texture": texture(material.emissive_texture),
        "normal_texture": texture(material.normal_texture), "normal_scale": material.normal_scale,
        "metallic_roughness_texture": texture(material.metallic_roughness_texture), "colored": material.colored,
    }  # fmt: skip


def _linear(color: Sequence[float]) -> list[float]:
    return [float(v) for v in linear_from_srgb(np.asarray(color, dtype=np.float64))]
