"""Links near a link, and contacts of all bodies."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gibson_sim.description.body import BodySpec
from gibson_sim.description.shapes import Shape
from gibson_sim.description.urdf import Inertial, UrdfCollision, UrdfJoint, UrdfLink, UrdfModel
from gibson_sim.errors import PhysicsError
from gibson_sim.physics.world import GROUND, PhysicsWorld
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim.types import Pose, Vec3

INERTIA = (0.01, 0.0, 0.0, 0.01, 0.0, 0.01)
FINGER = Shape("sphere", (0.01, 0.0, 0.0))


def body(name: str, position: Vec3, shape: Shape) -> BodySpec:
    link = UrdfLink("body", (), (UrdfCollision(shape, Pose()),), Inertial(1.0, Pose(), INERTIA))
    return BodySpec(name, UrdfModel(name, Path("/nowhere/x.urdf"), (link,), ()), Pose(position))


def cabinet() -> BodySpec:
    """A door of 0.4 x 0.02 x 0.6 m in the plane y = 0, and a bar 0.04 m in front of it on a fixed joint."""
    door = UrdfCollision(Shape("box", (0.4, 0.02, 0.6)), Pose((0.2, 0.0, 0.0)))
    bar = UrdfCollision(Shape("cylinder", (0.01, 0.2, 0.0)), Pose())
    links = (
        UrdfLink("frame", (), (), Inertial(5.0, Pose(), INERTIA)),
        UrdfLink("door", (), (door,), Inertial(2.0, Pose((0.2, 0.0, 0.0)), INERTIA)),
        UrdfLink("handle", (), (bar,), None),
    )
    joints = (
        UrdfJoint("hinge", "revolute", "frame", "door", Pose(), (0.0, 0.0, 1.0), -1.5, 0.0),
        UrdfJoint("fixed", "fixed", "door", "handle", Pose((0.35, -0.05, 0.0)), (1.0, 0.0, 0.0)),
    )
    return BodySpec("cabinet", UrdfModel("cabinet", Path("/nowhere/c.urdf"), links, joints), Pose((0.0, 0.0, 1.0)), True)


def world_of(*bodies: BodySpec, gravity: float = 0.0, ground_z: float | None = None) -> PhysicsWorld:
    scene = SceneSpec("test", Path("/nowhere"), "", (), (), ground_z=ground_z, gravity=(0.0, 0.0, -gravity), bodies=bodies)
    return PhysicsWorld(scene)


def test_neighbours_are_sorted_by_distance_and_the_handle_is_distinguished_from_its_door() -> None:
    ball = body("ball", (0.35, -0.40, 1.0), Shape("sphere", (0.05, 0.0, 0.0)))
    with world_of(cabinet(), ball, body("finger", (0.35, -0.16, 1.0), FINGER)) as world:
        found = world.neighbours("finger", "body", 0.2)
        assert [(one.body, one.link) for one in found] == [("cabinet", "handle"), ("cabinet", "door"), ("ball", "body")]
        # Centres 0.11 m apart, less two radii of 0.01 m; the door's face is at y = -0.01.
        assert [one.distance for one in found] == pytest.approx([0.09, 0.14, 0.18], abs=1e-3)
        handle = found[0]
        assert handle.point == pytest.approx((0.35, -0.06, 1.0), abs=2e-3)
        assert handle.own_point == pytest.approx((0.35, -0.15, 1.0), abs=2e-3)
        assert handle.normal == pytest.approx((0.0, -1.0, 0.0), abs=0.02)


def test_link_is_distinguished_from_links_fixed_to_it() -> None:
    ball = UrdfCollision(FINGER, Pose())
    links = (
        UrdfLink("palm", (), (ball,), Inertial(1.0, Pose(), INERTIA)),
        UrdfLink("tip", (), (ball,), None),
        UrdfLink("frame", (), (), None),
    )
    joints = (
        UrdfJoint("a", "fixed", "palm", "tip", Pose((0.1, 0.0, 0.0)), (1.0, 0.0, 0.0)),
        UrdfJoint("b", "fixed", "palm", "frame", Pose((0.05, 0.0, 0.0)), (1.0, 0.0, 0.0)),
    )
    hand = BodySpec("hand", UrdfModel("hand", Path("/nowhere/h.urdf"), links, joints), Pose())
    with world_of(hand, body("box", (0.3, 0.0, 0.0), Shape("box", (0.1, 0.1, 0.1)))) as world:
        far, near, any_of_them = (world.neighbours("hand", link, 0.5)[0] for link in ("palm", "tip", "frame"))
        assert (far.distance, near.distance) == pytest.approx((0.24, 0.14), abs=1e-3)
        assert any_of_them == near


def test_threshold_of_20_centimetres_holds_to_a_millimetre() -> None:
    for gap, near in ((0.199, True), (0.201, False)):
        with world_of(
            body("box", (0.0, 0.0, 0.0), Shape("box", (0.1, 0.1, 0.1))), body("finger", (0.06 + gap, 0.0, 0.0), FINGER)
        ) as world:
            found = world.neighbours("finger", "body", 0.2)
            assert [one.distance for one in found] == ([pytest.approx(gap, abs=1e-4)] if near else [])


def test_neighbours_of_a_newly_placed_body_are_found_without_a_step() -> None:
    with world_of(body("box", (5.0, 0.0, 0.0), Shape("box", (0.1, 0.1, 0.1))), body("finger", (0.1, 0.0, 0.0), FINGER)) as world:
        world.step()
        assert world.neighbours("finger", "body", 0.2) == ()
        world.set_state("box", Pose())
        assert [one.distance for one in world.neighbours("finger", "body", 0.2)] == [pytest.approx(0.04, abs=1e-4)]
        world.remove("box")
        assert world.neighbours("finger", "body", 0.2) == ()


def test_neighbours_of_an_unknown_body_are_refused() -> None:
    with world_of(body("finger", (0.0, 0.0, 0.0), FINGER)) as world:
        with pytest.raises(PhysicsError, match="no robot or body 'thumb' in this world"):
            world.neighbours("thumb", "body", 0.2)
        with pytest.raises(PhysicsError, match="'finger' has no link 'nail'; known: body"):
            world.neighbours("finger", "nail", 0.2)


def test_contacts_of_all_bodies_are_those_of_each_and_every_point_is_there_once() -> None:
    cube = Shape("box", (0.2, 0.2, 0.2))
    bodies = [body("low", (0.0, 0.0, 0.1), cube), body("high", (0.0, 0.0, 0.3), cube), body("alone", (1.0, 0.0, 0.1), cube)]
    with world_of(*bodies, gravity=9.81, ground_z=0.0) as world:
        world.step(240)
        found = world.contacts()
        pairs = {tuple(sorted((contact.body_a, contact.body_b))) for contact in found}
        assert pairs == {("ground", "low"), ("high", "low"), ("alone", "ground")}
        assert all(contact.body_a != GROUND and contact.link_a == "body" for contact in found)
        assert sum(contact.force for contact in found if contact.body_b == GROUND) == pytest.approx(3 * 9.81, rel=0.02)
        of_each = sum(len(world.contacts(one.name)) for one in bodies)
        between = sum(contact.body_b != GROUND for contact in found)
        assert len(found) == of_each - between, "a point between two bodies is told to both of them"
        pushed = np.array([contact.normal for contact in found if (contact.body_a, contact.body_b) == ("high", "low")])
        pulled = -np.array([contact.normal for contact in found if (contact.body_a, contact.body_b) == ("low", "high")])
        assert np.concatenate([pushed.reshape(-1, 3), pulled.reshape(-1, 3)])[:, 2] == pytest.approx(1.0, abs=1e-3)
