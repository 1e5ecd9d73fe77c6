"""A small world of bodies, without files."""

from __future__ import annotations

from pathlib import Path

from gibson_sim.description.body import BodySpec
from gibson_sim.description.shapes import Shape
from gibson_sim.description.urdf import Inertial, UrdfCollision, UrdfLink, UrdfModel, UrdfVisual
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim.types import Pose

BALL = """
<robot name="ball">
  <link name="ball_link">
    <inertial><mass value="1.0"/><inertia ixx="0.004" ixy="0" ixz="0" iyy="0.004" iyz="0" izz="0.004"/></inertial>
    <visual><geometry><sphere radius="0.1"/></geometry></visual>
    <collision><geometry><sphere radius="0.1"/></geometry></collision>
  </link>
</robot>
"""
"""One kilogram, 0.1 m in radius, as URDF."""


def box(name: str, x: float, *, static: bool = False, semantic_class: str = "box", size: float = 0.2) -> BodySpec:
    """A cube that stands on the ground."""
    shape = Shape("box", (size, size, size))
    inertial = Inertial(1.0, Pose(), (0.01, 0.0, 0.0, 0.01, 0.0, 0.01))
    link = UrdfLink("body", (UrdfVisual(shape, Pose(), None),), (UrdfCollision(shape, Pose()),), inertial)
    model = UrdfModel(name, Path("/nowhere/x.urdf"), (link,), ())
    return BodySpec(name, model, Pose((x, 0.0, size / 2)), static, semantic_class)


SCENE = SceneSpec(
    "yard",
    Path("/nowhere"),
    "0",
    (),
    (),
    ground_z=0.0,
    bodies=(box("crate", 1.0), box("wall", 3.0, static=True, semantic_class="wall"), box("anna", 5.0, semantic_class="person")),
)
"""A yard with a crate, a wall and a person, 2 m apart along x."""
