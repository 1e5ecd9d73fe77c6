"""OBJ files for the engine: what would crash it is left out, the objects stay."""

from __future__ import annotations

from pathlib import Path

from gibson_sim.description.body import BodySpec
from gibson_sim.physics.engine_files import shapes_alone
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.scenes.spawning import load_spawnable
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim.types import Pose

CRASHES = """mtllib a.mtl
v 0.0 0.0 0.0
v 0.4 0.0 0.0
v 0.0 0.4 0.0
v 0.4 0.4 0.0
v 0.2 0.2 0.3
vt 0.0 0.0
f -2 -5 -1
o pyramid
f 1/1/1 3/3/1 2/2/1
f 1/0/1 4/4/1 3/3/1
s off
g rest
f -4 -3 -1
f 1 2 3 9
f 1 2
f x y z
"""
"""Every kind of corner with which PyBullet's OBJ reader reads out of bounds."""

LOADED = """mtllib a.mtl
v 0.0 0.0 0.0
v 0.4 0.0 0.0
v 0.0 0.4 0.0
v 0.4 0.4 0.0
v 0.0 0.4 0.0
v 0.2 0.2 0.3
vt 0.0 -0.01
vt 1.0 0.0
f -2 -5 -1
vt 1.0 1.0
vt 0.0 1.0
vt 0.5 0.5
vn 0 0 1
o pyramid
usemtl m
f 1/1/1 3/3/1 2/2/1
f 1/0/1 4/4/1 3/3/1
f 1/1/1 2/2/1 5/5/1
g rest
usemtl n
s off
f -4 -3 -1
g rest
f -3 -2 -1
f -2 -5 -1
f 1 2 3 4
"""
"""Accepted by the scene loader; PyBullet's OBJ reader crashed on it."""


def test_faces_keep_vertex_indices_only_and_invalid_faces_are_dropped() -> None:
    assert shapes_alone(CRASHES.encode()).decode().splitlines() == [
        "v 0.0 0.0 0.0",
        "v 0.4 0.0 0.0",
        "v 0.0 0.4 0.0",
        "v 0.4 0.4 0.0",
        "v 0.2 0.2 0.3",
        "f 4 1 5",
        "o pyramid",
        "f 1 3 2",
        "f 1 4 3",
        "g rest",
        "f 2 3 5",
    ]


def test_a_mesh_that_crashed_the_engine_is_loaded_and_falls(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text(LOADED)
    (tmp_path / "a.mtl").write_text("newmtl m\nKd 1 0 0\nnewmtl n\nKd 0 1 0\n")
    body = load_spawnable(str(tmp_path / "a.obj"), "", name="thing", pose=Pose((0.0, 0.0, 1.0)))
    assert isinstance(body, BodySpec)
    with PhysicsWorld(SceneSpec("s", tmp_path, "", (), (), ground_z=0.0, bodies=(body,))) as world:
        world.step(240)
        assert -0.01 < world.body_pose("thing").position[2] < 0.5
