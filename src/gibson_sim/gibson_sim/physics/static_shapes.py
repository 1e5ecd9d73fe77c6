"""What never moves: the ground and the collision shapes of a scene, put into the engine once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gibson_sim.errors import MeshError
from gibson_sim.physics.bullet import Bullet
from gibson_sim.quoting import quoted
from gibson_sim.robots.spec import Shape
from gibson_sim.scenes.mesh import MeshLoader, scene_roots
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim.types import Pose

GROUND = "ground"
"""What contacts call the endless plane."""
_SMALLEST_AREA = 1e-12
"""Square metres: smaller triangles are dropped; their normal is noise, and Bullet's contacts with them too."""


def add_static_shapes(bullet: Bullet, scene: SceneSpec) -> list[str]:
    """Puts the ground and all collision shapes of a scene into the engine; returns what was left out, one line each."""
    warnings: list[str] = []
    if scene.ground_z is not None:
        bullet.add_static(bullet.plane_shape(), Pose((0.0, 0.0, scene.ground_z)), GROUND)
    loader = MeshLoader(scene_roots(scene), textures=False)
    known: dict[Shape, Sequence[int]] = {}
    for collision in scene.collisions:
        if collision.shape not in known:
            known[collision.shape] = _static_shape(bullet, loader, collision.shape, collision.name, warnings)
        bullet.add_static(known[collision.shape], collision.pose, collision.name)
    return warnings


def _static_shape(bullet: Bullet, loader: MeshLoader, shape: Shape, name: str, warnings: list[str]) -> Sequence[int]:
    """Returns the engine's numbers of a shape; none, with a warning, for a mesh without collision geometry."""
    if shape.kind == "box":
        return bullet.box_shape(shape.size)
    if shape.kind == "sphere":
        return bullet.sphere_shape(shape.size[0])
    if shape.kind == "cylinder":
        return bullet.cylinder_shape(shape.size[0], shape.size[1])
    try:
        vertices, triangles = loader.shape(shape).merged()
    except MeshError as error:
        warnings.append(f"collision {quoted(name)} is left out: {error}")
        return []
    sound = sound_triangles(vertices, triangles)
    if not len(sound):
        warnings.append(f"collision {quoted(name)} is left out: {shape.mesh} has no triangle with an area")
        return []
    return bullet.mesh_shape(vertices, sound, shape.mesh)


def sound_triangles(vertices: NDArray[np.float64], triangles: ArrayLike) -> NDArray[np.int64]:
    """Returns those of ``triangles``, (T, 3), that have an area and finite corners."""
    corners: NDArray[np.int64] = np.asarray(triangles, dtype=np.int64).reshape(-1, 3)
    a, b, c = (vertices[corners[:, i]] for i in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    sound: NDArray[np.int64] = corners[np.isfinite(area) & (area > _SMALLEST_AREA)]
    return sound
