"""Asks physics whether shapes touch anything static at many places."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gibson_sim.description.shapes import Shape
from gibson_sim.formats.load_mesh import load_mesh
from gibson_sim.geometry.transforms import pose_from_xyz_rpy
from gibson_sim.physics.bullet import Bullet
from gibson_sim.types import Pose

_URDF = """<robot name="probe"><link name="probe">
<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><geometry>{geometry}</geometry></collision></link></robot>"""
SPHERE = _URDF.format(geometry='<sphere radius="{size}"/>')
BOX = _URDF.format(geometry='<box size="{size} {size} {size}"/>')
_NOWHERE = Pose((0.0, 0.0, 1e4))


def write_mesh(path: Path, vertices: NDArray[np.float64], triangles: NDArray[np.int64]) -> Shape:
    """Writes an OBJ and returns it as a shape."""
    with path.open("w") as file:
        np.savetxt(file, vertices, fmt="v %.6f %.6f %.6f")
        np.savetxt(file, triangles + 1, fmt="f %d %d %d")
    return Shape("mesh", (1.0, 1.0, 1.0), str(path))


def random_places(vertices: NDArray[np.float64], count: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Returns places (N, 6) for ``verdicts`` in the lowest two metres of the box about vertices (V, 3), upright, of any heading."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    high[2] = min(high[2], low[2] + 2.0)
    turns = np.zeros((count, 3))
    turns[:, 2] = rng.uniform(-np.pi, np.pi, count)
    return np.concatenate([rng.uniform(low, high, (count, 3)), turns], axis=1)


def verdicts(
    shapes: Sequence[tuple[Shape, Pose]], places: NDArray[np.float64], sizes: Sequence[float], kind: str
) -> NDArray[np.bool_]:
    """Returns whether a probe touches one of the shapes, (N,).

    Args:
        shapes: boxes and meshes, with T_world_shape.
        places: (N, 6), x, y, z, metres, and roll, pitch, yaw, radians, of probes.
        sizes: radii of spheres or edges of boxes, metres; the probes take turns.
        kind: ``SPHERE`` or ``BOX``.
    """
    bullet = Bullet(240, (0.0, 0.0, 0.0))
    try:
        for shape, pose in shapes:
            made = bullet.box_shape(shape.size) if shape.kind == "box" else _mesh(bullet, shape)
            bullet.add_static(made, pose, "scan")
        bodies = [bullet.load_urdf(kind.format(size=size), _NOWHERE, "probe") for size in sizes]
        out = np.zeros(len(places), dtype=bool)
        still = np.zeros(3)
        for i, (x, y, z, *turn) in enumerate(places.tolist()):
            body = bodies[i % len(bodies)]
            pose = pose_from_xyz_rpy((x, y, z), (turn[0], turn[1], turn[2]))
            bullet.place(body, pose)
            bullet.set_velocity(body, pose.quat_xyzw, still, still)
            bullet.step()
            out[i] = bool(bullet.contacts(body))
            bullet.place(body, _NOWHERE)
        return out
    finally:
        bullet.close()


def _mesh(bullet: Bullet, shape: Shape) -> list[int]:
    from pathlib import Path

    path = Path(shape.mesh)
    vertices, triangles = load_mesh(path, [path.parent]).merged()
    return bullet.mesh_shape(vertices, triangles.astype(np.int64), shape.mesh)
