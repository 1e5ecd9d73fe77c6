"""Attached links: nothing jumps, no force exceeds its limit, nothing is left over."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gibson_sim.description.body import BodySpec
from gibson_sim.description.shapes import Shape
from gibson_sim.description.urdf import Inertial, UrdfCollision, UrdfJoint, UrdfLink, UrdfModel
from gibson_sim.errors import PhysicsError
from gibson_sim.geometry.transforms import matrix_from_quat, pose_from_xyz_rpy
from gibson_sim.physics.attachments import AttachmentKind
from gibson_sim.physics.engine import pybullet
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.robots.joints.commands import JointEfforts, JointPositions, JointVelocities
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim.types import Pose

INERTIA = (0.02, 0.0, 0.0, 0.02, 0.0, 0.02)
CENTER = pose_from_xyz_rpy((0.05, -0.02, 0.03), (0.4, 0.1, 0.7))
KINDS: tuple[AttachmentKind, ...] = ("ball", "fixed")


def cube(name: str, pose: Pose, *, kilograms: float = 2.0, static: bool = False) -> BodySpec:
    """A cube whose inertial frame is displaced and rotated, so that confusing it with the link's frame fails."""
    box = UrdfCollision(Shape("box", (0.1, 0.1, 0.1)), Pose())
    link = UrdfLink("body", (), (box,), Inertial(kilograms, CENTER, INERTIA))
    return BodySpec(name, UrdfModel(name, Path("/nowhere/x.urdf"), (link,), ()), pose, static)


def door(name: str = "door") -> BodySpec:
    """A leaf of 10 kg that turns about z, and its handle at 0.7 m."""
    middle = Pose((0.4, 0.0, 1.0))
    mass = Inertial(10.0, middle, (3.0, 0.0, 0.0, 3.5, 0.0, 0.55))
    links = (
        UrdfLink("frame", (), (), Inertial(1.0, Pose(), INERTIA)),
        UrdfLink("leaf", (), (UrdfCollision(Shape("box", (0.8, 0.04, 2.0)), middle),), mass),
        UrdfLink("handle", (), (UrdfCollision(Shape("box", (0.1, 0.02, 0.02)), Pose()),), None),
    )
    hinge = UrdfJoint("hinge", "revolute", "frame", "leaf", Pose(), (0.0, 0.0, 1.0), 0.0, 1.6)
    fixed = UrdfJoint("fixed", "fixed", "leaf", "handle", Pose((0.7, -0.06, 1.0)), (1.0, 0.0, 0.0))
    return BodySpec(name, UrdfModel(name, Path("/nowhere/d.urdf"), links, (hinge, fixed)), Pose(), True)


def world_of(*bodies: BodySpec, gravity: float = 0.0) -> PhysicsWorld:
    scene = SceneSpec("test", Path("/nowhere"), "", (), (), gravity=(0.0, 0.0, -gravity), bodies=bodies)
    return PhysicsWorld(scene)


def momentum(world: PhysicsWorld, name: str, kilograms: float) -> NDArray[np.float64]:
    """Returns the momentum of its centre of mass, kg m/s."""
    linear, angular = world.body_twist(name)
    arm = matrix_from_quat(world.body_pose(name).quat_xyzw) @ np.array(CENTER.position)
    return np.asarray(kilograms * (linear + np.cross(angular, arm)))


def constraints(world: PhysicsWorld) -> int:
    return int(pybullet.getNumConstraints(physicsClientId=world._bullet.client))


TURNED = pose_from_xyz_rpy((0.5, 0.3, -0.2), (0.3, -0.5, 1.1))


@pytest.mark.parametrize("kind", KINDS)
def test_attaching_at_a_distance_moves_no_body(kind: AttachmentKind) -> None:
    with world_of(cube("hand", Pose(), static=True), cube("cup", TURNED)) as world:
        world.attachments.attach("hand", "body", "cup", "body", kind=kind)
        for _ in range(240):
            world.step()
            assert np.abs(np.concatenate(world.body_twist("cup"))).max() < 1e-6
        assert world.body_pose("cup").position == pytest.approx(TURNED.position, abs=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_fixed_attachment_keeps_the_angle_and_ball_attachment_lets_the_body_swing(kind: AttachmentKind) -> None:
    beside = Pose((0.3, 0.0, 0.0))
    with world_of(cube("hand", Pose(), static=True), cube("cup", beside), gravity=9.81) as world:
        handle = world.attachments.attach("hand", "body", "cup", "body", kind=kind)
        world.step(120)
        pose = world.body_pose("cup")
        assert math.dist(pose.position, (0.0, 0.0, 0.0)) == pytest.approx(0.3, abs=2e-3)
        load = world.attachments.load(handle)
        if kind == "fixed":
            assert pose.position == pytest.approx(beside.position, abs=2e-3)
            # 2 kg whose centre is 0.35 m to the side and 0.02 m off it.
            assert (load.force, load.torque) == pytest.approx((2 * 9.81, 2 * 9.81 * math.hypot(0.35, 0.02)), rel=0.02)
        else:
            assert pose.position[2] < -0.1
            assert load.torque == 0.0


def test_point_sets_the_position_of_the_ball_joint() -> None:
    with world_of(cube("hand", Pose(), static=True), cube("cup", Pose((0.3, 0.0, 0.0))), gravity=9.81) as world:
        world.attachments.attach("hand", "body", "cup", "body", point=(0.3, 0.0, 0.0))
        world.step(240)
        assert world.body_pose("cup").position == pytest.approx((0.3, 0.0, 0.0), abs=2e-3)


def test_moved_gripper_pulls_the_attached_door_handle() -> None:
    with world_of(door(), cube("hand", Pose((0.7, -0.2, 1.0)), static=True)) as world:
        handle = world.attachments.attach("hand", "body", "door", "handle", point=(0.7, -0.06, 1.0))
        radius = math.hypot(0.7, 0.06)
        for k in range(240):
            angle = -math.atan2(0.06, 0.7) + k / 240
            turn = k / 240
            x, y = radius * math.cos(angle), radius * math.sin(angle)
            # The hand goes with the handle, 0.14 m from it.
            out = (x + 0.14 * math.sin(turn), y - 0.14 * math.cos(turn), 1.0)
            world.set_state("hand", pose_from_xyz_rpy(out, (0.0, 0.0, turn)))
            world.step()
        assert world.joint_states("door").positions[0] == pytest.approx(1.0, abs=0.03)
        world.attachments.detach(handle)
        world.set_state("hand", Pose((3.0, 0.0, 1.0)))
        world.step(10)
        assert constraints(world) == 0


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("way", [(-1.0, 0.0, 0.0), (-1.0, 1.0, 0.0), (-1.0, -1.0, 1.0), (-0.2, 0.5, -1.0)])
def test_force_never_exceeds_its_limit_and_overload_separates_the_bodies(
    kind: AttachmentKind, way: tuple[float, float, float]
) -> None:
    limit, ahead = 50.0, np.array(way) / math.hypot(*way)
    with world_of(cube("hand", Pose(), static=True), cube("crate", Pose((0.3, 0.0, 0.0)), kilograms=40.0)) as world:
        handle = world.attachments.attach("hand", "body", "crate", "body", kind=kind, max_force=limit)
        most, felt, before = 0.0, 0.0, momentum(world, "crate", 40.0)
        for k in range(60):
            # 4 m/s within a quarter of a second: 640 N would be needed.
            x, y, z = (ahead * 16.0 * (k / 240) ** 2 / 2).tolist()
            world.set_state("hand", Pose((x, y, z)))
            world.step()
            most = max(most, world.attachments.load(handle).force)
            now = momentum(world, "crate", 40.0)
            felt, before = max(felt, float(np.linalg.norm(now - before)) * 240), now
        assert not world.contacts("crate"), "nothing else pushes"
        assert 0.9 * limit < most < 1.05 * limit
        assert felt == pytest.approx(most, rel=0.02)
        behind = math.dist(world.body_pose("crate").position, (0.3, 0.0, 0.0))
        assert behind < 0.3


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("way", [(0.0, 0.0, -1.0), (1.0, 0.0, 0.0), (1.0, -1.0, 0.0), (1.0, 0.4, -0.2)])
@pytest.mark.parametrize(("part", "holds"), [(0.95, True), (1.06, False)])
def test_a_steady_pull_is_borne_up_to_the_limit_in_every_direction(
    kind: AttachmentKind, way: tuple[float, float, float], part: float, holds: bool
) -> None:
    limit = 50.0
    x, y, z = (np.array(way) / math.hypot(*way) * part * limit / 2.0).tolist()
    crate = cube("crate", Pose((0.3, 0.0, 0.0)))
    scene = SceneSpec("test", Path("/nowhere"), "", (), (), gravity=(x, y, z), bodies=(cube("hand", Pose(), static=True), crate))
    with PhysicsWorld(scene) as world:
        middle = CENTER.position
        at = (0.3 + middle[0], middle[1], middle[2])
        handle = world.attachments.attach("hand", "body", "crate", "body", kind=kind, max_force=limit, point=at)
        loads = []
        for _ in range(240):
            world.step()
            loads.append(world.attachments.load(handle).force)
        away = math.dist(world.body_pose("crate").position, (0.3, 0.0, 0.0))
        assert max(loads) < 1.05 * limit
        assert (away < 0.01) is holds, away
        assert loads[-1] == pytest.approx(min(part, 0.97) * limit, rel=0.01)


def test_sudden_jerks_to_all_sides_never_exceed_the_limit() -> None:
    limit, rng = 500.0, np.random.default_rng(3)
    with world_of(cube("hand", Pose(), static=True), cube("crate", Pose((0.3, 0.0, 0.0)), kilograms=40.0)) as world:
        handle = world.attachments.attach("hand", "body", "crate", "body", kind="fixed", max_force=limit)
        for _ in range(300):
            x, y, z = rng.normal(0.0, 0.05, 3).tolist()
            if rng.random() < 0.3:
                world.set_state("hand", Pose((x, y, z)))
            world.step()
            load = world.attachments.load(handle)
            assert max(load.force, load.torque) < 1.05 * limit


def test_feed_forward_force_ends_with_the_pull() -> None:
    """The feed-forward force must not push on when the pull ends."""
    with world_of(cube("hand", Pose(), static=True), cube("cup", Pose((0.3, 0.0, 0.0))), gravity=17.5) as world:
        handle = world.attachments.attach("hand", "body", "cup", "body", kind="fixed", max_force=50.0)
        world.step(120)
        assert world.attachments.load(handle).force == pytest.approx(35.0, rel=0.01)
        world.set_state("cup", linear=(0.0, 0.0, 0.2), angular=(0.0, 0.0, 0.0))
        heights = []
        for _ in range(240):
            world.step()
            heights.append(world.body_pose("cup").position[2])
        assert -0.01 < min(heights) < max(heights) < 0.005
        assert heights[-1] == pytest.approx(0.0, abs=1e-3)
        world.attachments.detach(handle)
        before = world.body_twist("cup")[0]
        world.step()
        assert world.body_twist("cup")[0] - before == pytest.approx((0.0, 0.0, -17.5 / 240), abs=0.02)


def swinging(world: PhysicsWorld) -> float:
    """Returns the energy of the leaf of the door, J: 0.55 kg m^2 about the upright axis through its middle, 10 kg at 0.4 m."""
    return 0.5 * (0.55 + 10.0 * 0.4**2) * float(world.joint_states("door").velocities[0]) ** 2


def push_door(world: PhysicsWorld) -> float:
    """Gives the door 2 rad/s and lets it swing by itself; returns its energy, J."""
    world.command_joints("door", JointVelocities((2.0,), ("hinge",)))
    world.step(30)
    world.command_joints("door", JointEfforts((0.0,), ("hinge",)))
    world.step()
    return swinging(world)


def test_a_door_that_swings_free_gains_no_energy() -> None:
    with world_of(door(), gravity=9.81) as world:
        most, farthest = push_door(world), 0.0
        assert most == pytest.approx(0.5 * 2.15 * 4.0, rel=0.05)
        for _ in range(480):
            world.step()
            now = swinging(world)
            assert now <= most + 1e-3
            most, farthest = min(most, now), max(farthest, float(world.joint_states("door").positions[0]))
        assert farthest > 1.59, "it reached its stop"


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("limit", [20.0, 60.0, 500.0])
def test_a_door_that_is_caught_held_and_let_go_gains_no_energy(kind: AttachmentKind, limit: float) -> None:
    with world_of(door(), cube("hand", Pose((0.5, 0.9, 1.0)), static=True), gravity=9.81) as world:
        most = push_door(world)
        handle = world.attachments.attach("hand", "body", "door", "handle", kind=kind, max_force=limit)
        borne = 0.0
        for _ in range(480):
            world.step()
            assert swinging(world) <= 1.001 * most
            borne = max(borne, world.attachments.load(handle).force)
        assert 0.0 < borne < 1.05 * limit
        assert swinging(world) < 0.05 * most, "it was caught"
        most = swinging(world)
        world.attachments.detach(handle)
        for _ in range(240):
            world.step()
            assert swinging(world) <= most + 1e-4


@pytest.mark.parametrize("kind", KINDS)
def test_a_thousand_attachments_leave_no_constraint_behind(kind: AttachmentKind) -> None:
    with world_of(cube("hand", Pose(), static=True), cube("cup", TURNED)) as world:
        handles = set()
        for _ in range(1_000):
            handle = world.attachments.attach("hand", "body", "cup", "body", kind=kind)
            handles.add(handle)
            world.step()
            world.attachments.detach(handle)
        assert (constraints(world), world.attachments.all, len(handles)) == (0, (), 1_000)
        world.set_state("cup", linear=(1.0, 0.0, 0.0), angular=(0.0, 0.0, 0.0))
        world.step(240)
        moved = np.array(world.body_pose("cup").position) - TURNED.position
        assert moved == pytest.approx((1.0, 0.0, 0.0), abs=1e-3), "it is free"


def _remove_child(world: PhysicsWorld) -> None:
    world.remove("cup")


def _remove_parent(world: PhysicsWorld) -> None:
    world.remove("hand")


@pytest.mark.parametrize("end", [_remove_child, _remove_parent, PhysicsWorld.reset, lambda world: world.attachments.detach_all()])
def test_attachments_end_with_either_body_and_at_a_reset(end: Callable[[PhysicsWorld], None]) -> None:
    with world_of(
        cube("hand", Pose(), static=True), cube("cup", TURNED), cube("hook", Pose((0.0, 2.0, 0.0)), static=True)
    ) as world:
        world.attachments.attach("hand", "body", "cup", "body")
        assert constraints(world) == len(world.attachments.all) == 1
        end(world)
        assert constraints(world) == len(world.attachments.all) == 0
        world.step(10)


def test_deletion_of_a_body_keeps_other_attachments() -> None:
    bodies = (cube("hand", Pose(), static=True), cube("cup", TURNED), cube("other", Pose((0.0, 1.0, 0.0))))
    with world_of(*bodies) as world:
        world.attachments.attach("hand", "body", "cup", "body")
        kept = world.attachments.attach("hand", "body", "other", "body", kind="fixed", max_force=80.0)
        world.remove("cup")
        (left,) = world.attachments.all
        assert (left.handle, left.child, left.kind, left.max_force) == (kept, "other", "fixed", 80.0)
        assert world.attachments.load(kept).force == pytest.approx(0.0, abs=1e-6)


def test_equal_runs_with_attachments_are_equal_to_the_bit_after_a_reset() -> None:
    def run(world: PhysicsWorld) -> bytes:
        handle = world.attachments.attach("hand", "body", "cup", "body", kind="fixed", max_force=30.0)
        world.step(60)
        world.attachments.detach(handle)
        world.attachments.attach("hand", "body", "cup", "body")
        world.step(60)
        return world.state().positions.tobytes() + world.state().twists.tobytes()

    with world_of(cube("hand", Pose(), static=True), cube("cup", TURNED), gravity=9.81) as world:
        first = run(world)
        world.reset()
        assert run(world) == first


def test_sleeping_body_wakes_when_attached_and_falls_when_detached() -> None:
    scene = SceneSpec("test", Path("/nowhere"), "", (), (), ground_z=0.0)
    with PhysicsWorld(scene) as world:
        world.add(cube("hand", Pose((0.0, 0.0, 1.0)), static=True))
        world.add(cube("cup", Pose((0.0, 0.0, 0.05))))
        world.step(720)
        handle = world.attachments.attach("hand", "body", "cup", "body", kind="fixed")
        for k in range(240):
            world.set_state("hand", Pose((0.0, 0.0, 1.0 + 0.002 * k)))
            world.step()
        height = world.body_pose("cup").position[2]
        assert height > 0.4
        world.step(720)
        assert not np.concatenate(world.body_twist("cup")).any(), "it sleeps in the air"
        for k in range(60):
            world.set_state("hand", Pose((0.0, 0.0, 1.48 + 0.002 * k)))
            world.step()
        assert world.body_pose("cup").position[2] > height + 0.1
        world.attachments.detach(handle)
        world.step(240)
        assert world.body_pose("cup").position[2] < 0.1


def test_motor_driven_door_wakes_the_attached_body() -> None:
    with world_of(door(), cube("cup", Pose((0.7, -0.5, 1.0)))) as world:
        world.attachments.attach("door", "handle", "cup", "body", kind="fixed")
        world.step(720)
        assert not np.concatenate(world.body_twist("cup")).any()
        world.command_joints("door", JointPositions((0.5,), ("hinge",)))
        world.step(480)
        assert world.joint_states("door").positions[0] == pytest.approx(0.5, abs=0.01)
        x, y = 0.7, -0.5
        turned = (x * math.cos(0.5) - y * math.sin(0.5), x * math.sin(0.5) + y * math.cos(0.5), 1.0)
        assert world.body_pose("cup").position == pytest.approx(turned, abs=0.01)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"kind": "glue"}, "must be one of ball, fixed"),
        ({"max_force": 0.0}, "must be a finite number above 0"),
        ({"child": "spoon"}, "no robot or body 'spoon' in this world"),
        ({"child_link": "lid"}, "'cup' has no link 'lid'; known: body"),
        ({"child": "hand"}, "are one rigid part"),
        ({"point": (0.0, math.nan, 0.0)}, "must be finite"),
    ],
)
def test_impossible_attachments_are_refused(change: dict[str, object], words: str) -> None:
    asked = {"parent": "hand", "parent_link": "body", "child": "cup", "child_link": "body", **change}
    with world_of(cube("hand", Pose(), static=True), cube("cup", TURNED)) as world:
        with pytest.raises(PhysicsError, match=words):
            world.attachments.attach(**asked)
        assert constraints(world) == len(world.attachments.all) == 0


def test_detaching_an_unattached_body_is_refused() -> None:
    with world_of(cube("hand", Pose(), static=True)) as world, pytest.raises(PhysicsError, match="handle 7; known: none"):
        world.attachments.detach(7)
