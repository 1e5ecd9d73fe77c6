"""Computes facts about a scene: sizes, triangles, materials, textures, floors, classes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.description.shapes import VisualSpec
from gibson_sim.formats.load_mesh import MeshLoader
from gibson_sim.formats.mesh import LightMapSource, Mesh, TextureSource, merge
from gibson_sim.geometry.transforms import matrix_from_pose, transform_points
from gibson_sim.reading import is_file
from gibson_sim.scenes.scene_meshes import scene_roots
from gibson_sim.scenes.scene_yaml import DESCRIPTION
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim.types import Vec3
from gibson_sim_tools.importing.checks.gravity import ON_ITS_SIDE_DEG, UpGuess, direction_text, guess_unit, guess_up

F64 = NDArray[np.float64]
_MAX_LISTED = 12
SUFFIXES_WITHOUT_UP_AXIS = (".ply", ".obj", ".stl")
"""Suffixes of formats that do not define the up axis."""
_ROTATION_TOLERANCE = 1e-6
"""Maximum difference between the entries of equal rotation matrices."""


@dataclass(frozen=True, slots=True)
class TextureFacts:
    """Facts about one image."""

    name: str
    width: int
    height: int
    memory_mb: float
    """Memory of the decoded image without mip levels, MB."""


@dataclass(frozen=True, slots=True)
class SceneFacts:
    """Facts about a scene; lengths in metres, world frame."""

    name: str
    low: tuple[float, float, float]
    high: tuple[float, float, float]
    objects: int
    triangles: int
    collision_triangles: int
    materials: int
    vertex_colors: bool
    textures: tuple[TextureFacts, ...]
    """Textures, the largest first."""
    up_axis: str
    """Axis nearest to up: z, unless the scene lies on its side; "" = not clear."""
    up: tuple[float, float, float]
    """Unit normal of the floors; z if up is not clear."""
    tilt_deg: float
    """Tilt of the floor against level; 0 if up is not clear."""
    unit: str
    """Unit in which the scene has the size of a room or a building; "" = none."""
    floors: tuple[float, ...]
    """Floor heights, m."""
    classes: dict[str, int]
    """Number of objects of each class."""
    bodies: int
    starts: tuple[str, ...]
    warnings: tuple[str, ...]

    @property
    def upright(self) -> bool:
        """Whether z is roughly up, so that the scene can be mapped."""
        return self.up_axis == "z" and self.up[2] > 0.0

    @property
    def size(self) -> tuple[float, float, float]:
        """Extents along x, y, z, m."""
        x, y, z = (h - low for h, low in zip(self.high, self.low, strict=True))
        return x, y, z

    def json(self) -> dict[str, Any]:
        """Returns the facts as plain values for JSON."""
        return {**asdict(self), "size": list(self.size)}

    def text(self) -> str:
        """Returns the facts as a text table."""
        memory = sum(t.memory_mb for t in self.textures)
        lines = [
            ("scene", self.name),
            ("size", " x ".join(f"{s:.2f}" for s in self.size) + " m"),
            ("from, to", f"({', '.join(f'{c:.2f}' for c in self.low)}) to ({', '.join(f'{c:.2f}' for c in self.high)})"),
            ("objects", f"{self.objects}, and {self.bodies} that move" if self.bodies else f"{self.objects}"),
            ("triangles", f"{self.triangles:,} visual, {self.collision_triangles:,} in collision shapes"),
            ("materials", f"{self.materials}" + (", with vertex colours" if self.vertex_colors else "")),
            ("textures", f"{len(self.textures)}, {memory:.0f} MB in memory"),
            *(("", f"{t.width} x {t.height}  {Path(t.name).name}") for t in self.textures[:_MAX_LISTED]),
            *([("", f"and {len(self.textures) - _MAX_LISTED} more")] if len(self.textures) > _MAX_LISTED else []),
            ("up", f"{direction_text(self.up)}, floor {self.tilt_deg:.2f} degrees out of level" if self.up_axis else "not clear"),
            ("unit", self.unit or "not clear: the size fits no room or building in m, cm, mm, inch, foot or km"),
            ("floors", ", ".join(f"{round(z, 2) + 0.0:.2f}" for z in self.floors) + " m"),
            ("classes", _classes_text(self.classes)),
            ("starts", ", ".join(self.starts) or "the most open place"),
        ]
        return "\n".join(f"{name:>10}  {value}" for name, value in lines)


def _classes_text(classes: dict[str, int]) -> str:
    if not classes:
        return "none"
    ordered = sorted(classes.items(), key=lambda item: (-item[1], item[0]))
    listed = ", ".join(f"{name} {count}" if count > 1 else name for name, count in ordered[:_MAX_LISTED])
    return listed + (f" and {len(ordered) - _MAX_LISTED} more" if len(ordered) > _MAX_LISTED else "")


@dataclass(frozen=True, slots=True, eq=False)
class DrawnGeometry:
    """Visual meshes of a scene, and all their triangles. Textures have the right size, but black pixels."""

    meshes: tuple[tuple[VisualSpec, Mesh], ...]
    """Visuals, and their meshes in the frame of the visual."""
    vertices: F64
    """Vertices, (V, 3), m, world frame."""
    triangles: NDArray[np.int32]
    """Triangles, (F, 3)."""


def scene_geometry(scene: SceneSpec) -> DrawnGeometry:
    """Loads the visual meshes of a scene.

    Raises:
        MeshError: a mesh cannot be read.
    """
    loader = MeshLoader(scene_roots(scene), textures="sizes")
    meshes = tuple((v, loader.shape(v.shape)) for v in scene.visuals)
    world_meshes = [(transform_points(matrix_from_pose(v.pose), m.merged()[0]), m.merged()[1]) for v, m in meshes]
    vertices, triangles = merge(world_meshes)
    return DrawnGeometry(meshes, vertices, triangles)


def scene_facts(scene: SceneSpec, geometry: DrawnGeometry | None = None, up: UpGuess | None = None) -> SceneFacts:
    """Returns the facts about a scene.

    Args:
        scene: the scene, as loaded.
        geometry: result of ``scene_geometry``; None = load it.
        up: result of ``guess_up``; None = estimate it.

    Raises:
        MeshError: a mesh cannot be read.
    """
    g = geometry or scene_geometry(scene)
    guess = up or guess_up(g.vertices, g.triangles, original_up(scene), declares_up(scene))
    low, high = (g.vertices.min(axis=0), g.vertices.max(axis=0)) if len(g.vertices) else (np.zeros(3), np.zeros(3))
    loader = MeshLoader(scene_roots(scene), textures=False)
    materials = {p.material for _, m in g.meshes for p in m.parts}
    classes: dict[str, int] = {}
    for visual in scene.visuals:
        if visual.semantic_class:
            classes[visual.semantic_class] = classes.get(visual.semantic_class, 0) + 1
    x0, y0, z0 = (round(float(c), 4) for c in low)
    x1, y1, z1 = (round(float(c), 4) for c in high)
    return SceneFacts(
        name=scene.name, low=(x0, y0, z0), high=(x1, y1, z1), objects=len(scene.visuals), triangles=len(g.triangles),
        collision_triangles=sum(loader.shape(c.shape).triangle_count for c in scene.collisions), materials=len(materials),
        vertex_colors=any(m.colored for m in materials), textures=texture_facts([m for _, m in g.meshes]),
        up_axis=guess.axis if guess.sure else "", up=guess.up, tilt_deg=round(guess.tilt_deg, 3), unit=guess_unit((high - low).tolist()),
        floors=tuple(scene.floors), classes=classes, bodies=len(scene.bodies), starts=tuple(s.name for s in scene.starts),
        warnings=tuple(map(str, scene.warnings)),
    )  # fmt: skip


def declares_up(scene: SceneSpec) -> bool:
    """Returns whether the scene description or a file format declares z up; the format of a single scan mesh does not."""
    suffixes = [Path(visual.shape.mesh).suffix.lower() for visual in scene.visuals]
    return is_file(scene.root / DESCRIPTION) or len(suffixes) != 1 or suffixes[0] not in SUFFIXES_WITHOUT_UP_AXIS


def original_up(scene: SceneSpec) -> Vec3 | None:
    """Returns the original direction of the meshes' z axis, unit vector, if one large rotation was applied to all, as levelling does; else None."""
    rotations = np.array([matrix_from_pose(visual.pose)[:3, :3] for visual in scene.visuals])
    if not len(rotations) or np.abs(rotations - rotations[0]).max() > _ROTATION_TOLERANCE:
        return None
    x, y, z = rotations[0, :, 2].tolist()
    return (x, y, z) if z < np.cos(np.radians(ON_ITS_SIDE_DEG)) else None


def textures_of(meshes: Sequence[Mesh]) -> list[TextureSource | LightMapSource]:
    """Returns the textures of meshes, light maps too, each once."""
    textures: dict[int, TextureSource | LightMapSource] = {}
    for mesh in meshes:
        for part in mesh.parts:
            m = part.material
            for texture in (
                m.texture, m.metallic_roughness_texture, m.normal_texture, m.occlusion_texture, m.emissive_texture, m.light_map,
            ):  # fmt: skip
                if texture is not None:
                    textures.setdefault(id(texture), texture)
    return list(textures.values())


def texture_facts(meshes: Sequence[Mesh]) -> tuple[TextureFacts, ...]:
    """Returns the facts about the textures of meshes, the largest first."""
    facts = [
        TextureFacts(t.name, t.pixels.shape[1], t.pixels.shape[0], round(t.pixels.nbytes / 2**20, 2)) for t in textures_of(meshes)
    ]
    return tuple(sorted(facts, key=lambda t: (-t.memory_mb, t.name)))
