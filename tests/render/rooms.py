"""The generated rooms as a small scene: each item of furniture is an instance."""

from __future__ import annotations

from functools import lru_cache

from gibson_sim.description.shapes import Shape, VisualSpec
from gibson_sim.formats.load_mesh import primitive_mesh
from gibson_sim.formats.mesh import Mesh
from gibson_sim.geometry.transforms import pose_from_matrix
from gibson_sim.render.batching.scene_geometry import Loader
from gibson_sim.types import Pose
from gibson_sim_tools.generator.rooms import rooms_camera_path, rooms_parts

TRIANGLES = 30_000


@lru_cache(maxsize=1)
def rooms() -> tuple[tuple[VisualSpec, ...], Loader]:
    """Returns the scene and its loader."""
    parts = rooms_parts(TRIANGLES, atlas=512)
    meshes = {f"/{name}": Mesh((part,)) for name, (_, part) in parts.items()}
    visuals = tuple(
        VisualSpec(name, "", Shape("mesh", mesh=f"/{name}"), semantic_class=kind) for name, (kind, _) in parts.items()
    )
    return visuals, lambda shape: meshes[shape.mesh] if shape.kind == "mesh" else primitive_mesh(shape)


def way(count: int) -> list[Pose]:
    """Returns poses of an optical frame on a drive through all the rooms."""
    return [pose_from_matrix(T) for T in rooms_camera_path(count)]
