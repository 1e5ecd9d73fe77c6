"""Bodies that are added to, moved in and removed from a running world."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from gibson_sim.description.body import BodySpec
from gibson_sim.description.shapes import Shape
from gibson_sim.description.urdf import Inertial, UrdfCollision, UrdfJoint, UrdfLink, UrdfModel, UrdfVisual
from gibson_sim.errors import PhysicsError
from gibson_sim.geometry.transforms import matrix_from_pose, pose_from_xyz_rpy
from gibson_sim.physics.body import hull_of
from gibson_sim.physics.world import GROUND, PhysicsWorld
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim.types import Pose

SCENE = SceneSpec("empty", Path("/nowhere"), "0", (), (), ground_z=0.0)
CUBE = Shape("box", (0.2, 0.2, 0.2))


def cube(name: str, start: Pose, *, static: bool = False, shape: Shape = CUBE, offset: Pose | None = None) -> BodySpec:
    """A body of 1 kg; ``offset`` is T_link_inertial and T_link_shape."""
    at = offset or Pose()
    inertial = Inertial(1.0, at, (0.01, 0.0, 0.0, 0.01, 0.0, 0.01))
    link = UrdfLink("body", (UrdfVisual(shape, at, None),), (UrdfCollision(shape, at),), inertial)
    return BodySpec(name, UrdfModel(name, Path("/nowhere/x.urdf"), (link,), ()), start, static, "box")


def at(x: float, y: float, z: float, yaw: float = 0.0) -> Pose:
    return pose_from_xyz_rpy((x, y, z), (0.0, 0.0, yaw))


def test_added_body_falls_and_rests_on_the_ground() -> None:
    with PhysicsWorld(SCENE) as world:
        world.add(cube("a", at(1.0, 2.0, 0.5)))
        world.step(480)
        assert world.body_pose("a").position == pytest.approx((1.0, 2.0, 0.1), abs=2e-3)
        assert world.links == ("a/body",)
        assert world.scene.revision == 2


def test_body_falls_as_far_as_gravity_says() -> None:
    with PhysicsWorld(SCENE) as world:
        world.add(cube("a", at(0.0, 0.0, 10.0)))
        world.step(120)
        # Semi-implicit Euler: n steps of dt fall g dt^2 n (n + 1) / 2.
        fallen = 9.81 / 240**2 * 120 * 121 / 2
        assert 10.0 - world.body_pose("a").position[2] == pytest.approx(fallen, rel=1e-4)
        _, angular = world.body_twist("a")
        linear, _ = world.body_twist("a")
        assert linear[2] == pytest.approx(-9.81 * 0.5, rel=1e-4)
        assert np.allclose(angular, 0.0)


def test_static_body_stays_and_others_rest_on_it() -> None:
    with PhysicsWorld(SCENE) as world:
        world.add(cube("below", at(0.0, 0.0, 1.0), static=True))
        world.add(cube("above", at(0.0, 0.0, 1.3)))
        world.step(480)
        assert world.body_pose("below") == at(0.0, 0.0, 1.0)
        assert world.body_pose("above").position[2] == pytest.approx(1.2, abs=2e-3)
        assert (world.is_static("below"), world.is_static("above")) == (True, False)


def test_body_with_offset_centre_of_mass_is_placed_and_moves_as_requested() -> None:
    offset = pose_from_xyz_rpy((0.3, -0.1, 0.2), (0.4, 0.0, 1.0))
    with PhysicsWorld(SCENE) as world:
        world.add(cube("a", at(0.0, 0.0, 5.0), offset=offset))
        wanted = pose_from_xyz_rpy((1.0, 2.0, 3.0), (0.1, 0.2, 0.3))
        world.set_state("a", wanted, (0.5, -0.25, 0.125), (1.0, 2.0, 3.0))
        assert world.body_pose("a").position == pytest.approx(wanted.position, abs=1e-9)
        assert np.abs(world.body_pose("a").quat_xyzw) == pytest.approx(np.abs(wanted.quat_xyzw), abs=1e-9)
        linear, angular = world.body_twist("a")
        assert linear == pytest.approx((0.5, -0.25, 0.125), abs=1e-9)
        assert angular == pytest.approx((1.0, 2.0, 3.0), abs=1e-9)


def test_pose_alone_keeps_the_velocity_and_velocity_alone_keeps_the_pose() -> None:
    with PhysicsWorld(SCENE) as world:
        world.add(cube("a", at(0.0, 0.0, 5.0)))
        world.set_state("a", linear=(1.0, 0.0, 0.0))
        world.set_state("a", at(3.0, 0.0, 5.0, math.pi / 2))
        assert world.body_twist("a")[0] == pytest.approx((1.0, 0.0, 0.0))
        assert world.body_pose("a").position == pytest.approx((3.0, 0.0, 5.0))


def test_removed_body_is_gone_and_its_name_is_free() -> None:
    with PhysicsWorld(SCENE) as world:
        world.add(cube("a", at(0.0, 0.0, 1.0)))
        world.remove("a")
        assert (world.names, world.links, world.state().positions.shape) == ((), (), (0, 3))
        world.add(cube("a", at(0.0, 0.0, 2.0)))
        assert world.scene.revision == 4
        with pytest.raises(PhysicsError, match=r"'b'.*known: a"):
            world.remove("b")


def test_name_that_is_taken_is_refused_and_nothing_changes() -> None:
    with PhysicsWorld(SCENE) as world:
        world.add(cube("a", at(0.0, 0.0, 1.0)))
        with pytest.raises(PhysicsError, match="'a' is taken"):
            world.add(cube("a", at(0.0, 0.0, 2.0)))
        assert world.scene.revision == 2


def test_reset_puts_added_bodies_back_and_runs_are_equal_to_the_bit() -> None:
    def run(world: PhysicsWorld) -> bytes:
        world.step(300)
        state = world.state()
        return state.positions.tobytes() + state.quats_xyzw.tobytes() + state.twists.tobytes()

    with PhysicsWorld(SCENE) as world:
        world.add(cube("a", pose_from_xyz_rpy((0.0, 0.0, 1.0), (0.3, 0.2, 0.1))))
        world.add(cube("b", pose_from_xyz_rpy((0.05, 0.0, 1.5), (0.5, 0.0, 0.1))))
        first = run(world)
        world.set_state("a", at(5.0, 5.0, 5.0))
        world.reset()
        assert run(world) == first


def test_bounds_hold_a_turned_box_a_ball_and_a_lying_cylinder() -> None:
    with PhysicsWorld(SCENE) as world:
        world.add(cube("box", at(1.0, 0.0, 1.0, math.pi / 4)))
        world.add(cube("ball", at(0.0, 0.0, 1.0), shape=Shape("sphere", (0.25, 0.0, 0.0))))
        lying = pose_from_xyz_rpy((0.0, 0.0, 2.0), (math.pi / 2, 0.0, 0.0))
        world.add(cube("tube", lying, shape=Shape("cylinder", (0.1, 1.0, 0.0))))
        half = 0.1 * math.sqrt(2.0)
        low, high = world.bounds("box")
        assert (*low, *high) == pytest.approx((1.0 - half, -half, 0.9, 1.0 + half, half, 1.1))
        low, high = world.bounds("ball")
        assert (*low, *high) == pytest.approx((-0.25, -0.25, 0.75, 0.25, 0.25, 1.25))
        low, high = world.bounds("tube")
        assert (*low, *high) == pytest.approx((-0.1, -0.5, 1.9, 0.1, 0.5, 2.1))


def test_bounds_in_the_frame_of_the_body_do_not_turn_with_it() -> None:
    with PhysicsWorld(SCENE) as world:
        world.add(cube("box", at(1.0, 2.0, 1.0, math.pi / 4), offset=Pose((0.5, 0.0, 0.0))))
        low, high = world.bounds("box", np.linalg.inv(matrix_from_pose(world.body_pose("box"))))
        assert (*low, *high) == pytest.approx((0.4, -0.1, -0.1, 0.6, 0.1, 0.1))


def test_contacts_name_both_sides_and_carry_the_weight() -> None:
    with PhysicsWorld(SCENE) as world:
        world.add(cube("below", at(0.0, 0.0, 0.1)))
        world.add(cube("above", at(0.0, 0.0, 0.3)))
        world.step(240)
        ground = [c for c in world.contacts("below") if c.body_b == GROUND]
        between = [c for c in world.contacts("above") if c.body_b == "below"]
        assert sum(c.force for c in ground) == pytest.approx(2 * 9.81, rel=0.02)
        assert sum(c.force for c in between) == pytest.approx(9.81, rel=0.02)
        assert {(c.link_a, c.link_b) for c in between} == {("body", "body")}
        assert all(-1e-3 < c.distance < 1e-3 for c in (*ground, *between))
        assert all(c.normal == pytest.approx((0.0, 0.0, 1.0), abs=1e-3) for c in (*ground, *between))
        upside_down = [c for c in world.contacts("below") if c.body_b == "above"]
        assert upside_down and all(c.normal[2] == pytest.approx(-1.0, abs=1e-3) for c in upside_down)


def test_mesh_in_a_format_that_the_engine_cannot_read_collides_as_its_hull(tmp_path: Path) -> None:
    # glTF has y up: 0.2 along its y becomes the height.
    trimesh.creation.box((0.4, 0.2, 0.4)).export(tmp_path / "box.glb")
    shape = Shape("mesh", (1.0, 1.0, 1.0), str(tmp_path / "box.glb"))
    with PhysicsWorld(SCENE) as world:
        world.add(cube("a", at(0.0, 0.0, 1.0), shape=shape))
        world.step(480)
        assert world.body_pose("a").position[2] == pytest.approx(0.1, abs=5e-3)
        low, high = world.bounds("a")
        assert high - low == pytest.approx((0.4, 0.4, 0.2), abs=1e-4)


def test_door_swings_when_pushed_and_returns_to_zero_at_reset() -> None:
    frame = UrdfLink("frame", (), (), Inertial(1.0, Pose(), (0.1, 0.0, 0.0, 0.1, 0.0, 0.1)))
    panel = Shape("box", (0.8, 0.04, 2.0))
    middle = Pose((0.4, 0.0, 1.0))
    leaf = UrdfLink("leaf", (), (UrdfCollision(panel, middle),), Inertial(10.0, middle, (3.0, 0.0, 0.0, 4.0, 0.0, 0.6)))
    hinge = UrdfJoint("hinge", "revolute", "frame", "leaf", Pose(), (0.0, 0.0, 1.0), -2.0, 2.0, damping=0.1)
    door = BodySpec("door", UrdfModel("door", Path("/nowhere/d.urdf"), (frame, leaf), (hinge,)), at(0.0, 0.0, 0.05), True)
    with PhysicsWorld(SCENE) as world:
        world.add(door)
        world.add(cube("ball", at(0.6, -1.0, 1.0), shape=Shape("sphere", (0.1, 0.0, 0.0))))
        world.set_state("ball", linear=(0.0, 6.0, 0.0))
        world.step(120)
        leaf_row = world.links.index("door/leaf")
        assert abs(world.state().quats_xyzw[leaf_row][2]) > 0.02, "the ball opens the door"
        world.reset()
        assert world.state().quats_xyzw[leaf_row] == pytest.approx((0.0, 0.0, 0.0, 1.0))


ASLEEP = 720
"""Steps after which bodies at rest sleep."""


def twists(world: PhysicsWorld, name: str) -> float:
    return float(np.abs(np.concatenate(world.body_twist(name))).max())


def test_resting_body_falls_asleep_and_does_not_move() -> None:
    with PhysicsWorld(SCENE) as world:
        world.add(cube("a", at(0.0, 0.0, 0.1)))
        world.step(ASLEEP)
        before = world.body_pose("a")
        world.step(ASLEEP)
        assert (world.body_pose("a"), twists(world, "a")) == (before, 0.0)


def test_sleeping_body_wakes_on_collision() -> None:
    with PhysicsWorld(SCENE) as world:
        world.add(cube("a", at(0.0, 0.0, 0.1)))
        world.add(cube("b", at(-1.0, 0.0, 0.1)))
        world.step(ASLEEP)
        world.set_state("b", linear=(5.0, 0.0, 0.0))
        world.step(120)
        assert world.body_pose("a").position[0] > 0.02


def test_sleeping_body_falls_when_its_support_is_removed_or_moved() -> None:
    with PhysicsWorld(SCENE) as world:
        for x, name in ((0.0, "gone"), (1.0, "moved")):
            world.add(cube(name, at(x, 0.0, 0.1), static=name == "moved"))
            world.add(cube(f"on_{name}", at(x, 0.0, 0.3)))
        world.step(ASLEEP)
        world.remove("gone")
        world.set_state("moved", at(5.0, 0.0, 0.1))
        world.step(240)
        assert world.body_pose("on_gone").position[2] == pytest.approx(0.1, abs=2e-3)
        assert world.body_pose("on_moved").position[2] == pytest.approx(0.1, abs=2e-3)


def test_lifted_sleeping_body_falls_and_pushed_sleeping_body_moves() -> None:
    with PhysicsWorld(SCENE) as world:
        world.add(cube("a", at(0.0, 0.0, 0.1)))
        world.step(ASLEEP)
        world.set_state("a", at(0.0, 0.0, 1.0))
        world.step(240)
        assert world.body_pose("a").position[2] == pytest.approx(0.1, abs=2e-3)
        world.step(ASLEEP)
        world.set_state("a", linear=(2.0, 0.0, 0.0))
        world.step(60)
        assert world.body_pose("a").position[0] > 0.2


def test_static_body_placed_into_a_sleeping_body_pushes_it() -> None:
    with PhysicsWorld(SCENE) as world:
        world.add(cube("a", at(0.0, 0.0, 0.1)))
        world.add(cube("wall", at(-0.3, 0.0, 0.1), static=True))
        world.step(ASLEEP)
        for i in range(300):
            world.set_state("wall", at(-0.3 + 0.001 * i, 0.0, 0.1))
            world.step()
        assert world.body_pose("a").position[0] > 0.15


def test_runs_with_sleeping_bodies_are_bit_equal_after_a_reset_and_in_a_new_world() -> None:
    bodies = tuple(cube(f"c{k}", pose_from_xyz_rpy((0.3 * k, 0.0, 0.3), (0.1 * k, 0.2, 0.0))) for k in range(4))
    scene = replace(SCENE, bodies=bodies)

    def run(world: PhysicsWorld) -> bytes:
        world.step(ASLEEP)
        world.set_state("c0", linear=(3.0, 0.0, 0.0))
        world.step(ASLEEP)
        state = world.state()
        return state.positions.tobytes() + state.quats_xyzw.tobytes() + state.twists.tobytes()

    with PhysicsWorld(scene) as world:
        first = run(world)
        world.reset()
        assert run(world) == first
    with PhysicsWorld(scene) as world:
        assert run(world) == first


def test_rolling_friction_brings_a_ball_to_rest() -> None:
    def ball(name: str, y: float, rolling: float) -> BodySpec:
        body = cube(name, at(0.0, y, 0.1), shape=Shape("sphere", (0.1, 0.0, 0.0)))
        link = replace(body.model.links[0], rolling_friction=rolling, spinning_friction=rolling)
        return replace(body, model=replace(body.model, links=(link,)))

    with PhysicsWorld(SCENE) as world:
        world.add(ball("smooth", 0.0, 0.0))
        world.add(ball("rough", 1.0, 0.01))
        for name in ("smooth", "rough"):
            world.set_state(name, linear=(1.0, 0.0, 0.0), angular=(0.0, 10.0, 0.0))
        world.step(960)
        assert twists(world, "rough") < 1e-3
        assert world.body_twist("smooth")[0][0] > 0.9


def test_joints_start_where_the_body_says_also_after_a_reset_and_in_a_new_world_to_the_bit() -> None:
    box = Shape("box", (0.2, 0.2, 0.2))
    mass = Inertial(1.0, Pose((0.2, 0.0, 0.0)), (0.01, 0.0, 0.0, 0.01, 0.0, 0.01))
    links = [UrdfLink(name, (), (UrdfCollision(box, Pose((0.2, 0.0, 0.0))),), mass) for name in ("body", "flap", "drawer")]
    flap = UrdfJoint("hinge", "revolute", "body", "flap", Pose((0.0, 0.0, 1.0)), (0.0, 1.0, 0.0), -2.0, 2.0, damping=0.01)
    slide = UrdfJoint("slide", "prismatic", "body", "drawer", Pose((0.0, 0.0, 2.0)), (1.0, 0.0, 0.0), 0.0, 0.4, damping=0.1)
    model = UrdfModel("chest", Path("/nowhere/c.urdf"), tuple(links), (flap, slide))
    chest = BodySpec("chest", model, at(1.0, 2.0, 0.1), static=True, joints=(("hinge", -0.5), ("slide", 0.3)))
    scene = replace(SCENE, bodies=(chest, cube("ball", at(1.3, 2.0, 3.0), shape=Shape("sphere", (0.1, 0.0, 0.0)))))

    def run(world: PhysicsWorld) -> bytes:
        world.step(200)
        state = world.state()
        return state.positions.tobytes() + state.quats_xyzw.tobytes() + state.twists.tobytes()

    with PhysicsWorld(scene) as world:
        start = world.state()
        flap_row, drawer_row = world.links.index("chest/flap"), world.links.index("chest/drawer")
        assert start.quats_xyzw[flap_row] == pytest.approx((0.0, math.sin(-0.25), 0.0, math.cos(-0.25)))
        assert start.positions[drawer_row] == pytest.approx((1.3, 2.0, 2.1))
        first = run(world)
        world.reset()
        assert world.state().positions.tobytes() == start.positions.tobytes()
        assert run(world) == first
    with PhysicsWorld(scene) as world:
        assert run(world) == first


def test_start_position_of_an_unknown_joint_is_refused() -> None:
    body = replace(cube("a", at(0.0, 0.0, 1.0)), joints=(("hinge", 0.5),))
    with pytest.raises(PhysicsError, match=r"'a' has no movable joint 'hinge'.*known: none"):
        PhysicsWorld(replace(SCENE, bodies=(body,)))


def test_adding_and_removing_thousands_of_bodies_leaks_nothing() -> None:
    with PhysicsWorld(SCENE) as world:
        for i in range(2000):
            world.add(cube(f"a{i}", at(0.0, 0.0, 1.0)))
            world.remove(f"a{i}")
        assert world.names == ()
        world.step()


def test_state_of_one_body_is_bit_equal_to_the_world_state() -> None:
    with PhysicsWorld(SCENE) as world:
        for name, x in (("a", 0.0), ("b", 1.0), ("c", 2.0)):
            world.add(cube(name, pose_from_xyz_rpy((x, 0.0, 0.5), (0.1, x, 0.0))))
        world.step(30)
        alone = world.state_of("b")
        whole = world.state()
        assert alone.links == ("b/body",)
        assert (alone.stamp_ns, alone.step, alone.revision) == (whole.stamp_ns, whole.step, whole.revision)
        for part, all_ in (
            (alone.positions, whole.positions),
            (alone.quats_xyzw, whole.quats_xyzw),
            (alone.twists, whole.twists),
        ):
            assert part[0].tobytes() == all_[1].tobytes()


def test_hull_of_a_changed_file_is_recomputed(tmp_path: Path) -> None:
    shape = Shape("mesh", (1.0, 1.0, 1.0), str(tmp_path / "box.ply"))
    for edge in (1.0, 3.0):
        trimesh.creation.box((edge, edge, edge)).export(tmp_path / "box.ply")
        assert np.ptp(hull_of(shape)[0], axis=0) == pytest.approx((edge, edge, edge))
