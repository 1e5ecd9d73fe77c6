"""Silhouettes of moving bodies agree with PyBullet's own software renderer, which has its own URDF reader, frames and rasteriser.

PyBullet draws coarse cylinders and spheres, up to 7 % too small, so it gets fine meshes for both.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gibson_sim.description.shapes import Shape, VisualSpec
from gibson_sim.geometry.transforms import invert, matrix_from_pose, pose_from_xyz_rpy
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.render.renderer import Renderer
from gibson_sim.robots.load import load_robot
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.scenes.spec import SceneSpec, drawn_scene
from gibson_sim.types import CameraSpec, SceneState
from render.drawing import eye_at
from support.surfaces import bumpy_sphere, grid_triangles

p = pytest.importorskip("pybullet")
pytestmark = [pytest.mark.egl, pytest.mark.usefixtures("egl")]

Mask = NDArray[np.bool_]
CAMERA = replace(
    eye_at((-1.5, -0.25, 0.75), look_at=(0.0, 0.0, 0.36)), name="eye", width=640, height=480, near=0.1, far=20.0, outputs=("instance",),
    matrix=(600.0, 0.0, 331.3, 0.0, 590.0, 232.8, 0.0, 0.0, 1.0),
)  # fmt: skip
OFFSET_URDF = """<robot name="offset">
<link name="base">
  <visual><origin xyz="0 0 0.05" rpy="0 0 0.2"/><geometry><box size="0.3 0.2 0.1"/></geometry></visual>
  <inertial><origin xyz="0.3 -0.2 0.5" rpy="0.4 0.5 0.6"/><mass value="2"/>
  <inertia ixx="0.1" ixy="0.01" ixz="0.02" iyy="0.2" iyz="0.03" izz="0.15"/></inertial>
</link>
<link name="arm">
  <visual><origin xyz="0.1 0 0" rpy="0 1.2 0.3"/><geometry><cylinder radius="0.05" length="0.3"/></geometry></visual>
  <visual><origin xyz="0.2 0.05 0.1"/><geometry><sphere radius="0.07"/></geometry></visual>
  <inertial><origin xyz="0.1 0.4 -0.2" rpy="0.3 0 0"/><mass value="1"/>
  <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial>
</link>
<link name="tip">
  <visual><geometry><box size="0.06 0.1 0.12"/></geometry></visual>
</link>
<joint name="j" type="continuous"><parent link="base"/><child link="arm"/><origin xyz="0 0 0.15" rpy="0.2 0 0"/><axis xyz="0 0 1"/></joint>
<joint name="t" type="fixed"><parent link="arm"/><child link="tip"/><origin xyz="0.25 0 0.15" rpy="0 0.7 0"/></joint>
</robot>"""


def _write_obj(path: Path, vertices: NDArray[np.float64], triangles: NDArray[np.int64]) -> Path:
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in vertices.tolist()]
    path.write_text("\n".join([*lines, *(f"f {a + 1} {b + 1} {c + 1}" for a, b, c in triangles.tolist())]) + "\n")
    return path


def _unit_shapes(folder: Path) -> dict[str, Path]:
    """Writes a fine sphere of radius 1, and a cylinder of radius 1 and length 1 about z."""
    around = np.linspace(0.0, 2 * math.pi, 97)
    down, turn = (g.ravel() for g in np.meshgrid(np.linspace(0.0, math.pi, 49), around, indexing="ij"))
    ball = np.stack([np.sin(down) * np.cos(turn), np.sin(down) * np.sin(turn), np.cos(down)], axis=1)
    profile = ((0.0, 0.5), (1.0, 0.5), (1.0, -0.5), (0.0, -0.5))
    tin = np.array([[r * math.cos(t), r * math.sin(t), z] for r, z in profile for t in around])
    return {
        "sphere": _write_obj(folder / "ball.obj", ball, grid_triangles(48, 96)),
        "cylinder": _write_obj(folder / "tin.obj", tin, grid_triangles(3, 96)),
    }


def _with_meshes(urdf: Path, shapes: dict[str, Path], to: Path) -> Path:
    """Writes a URDF whose cylinders and spheres are meshes."""
    text = re.sub(
        r'<cylinder radius="([\d.]+)" length="([\d.]+)"/>',
        lambda m: f'<mesh filename="{shapes["cylinder"]}" scale="{m[1]} {m[1]} {m[2]}"/>',
        urdf.read_text(),
    )
    text = re.sub(
        r'<sphere radius="([\d.]+)"/>', lambda m: f'<mesh filename="{shapes["sphere"]}" scale="{m[1]} {m[1]} {m[1]}"/>', text
    )
    to.write_text(text)
    return to


class _Reference:
    """The same bodies in a separate PyBullet."""

    def __init__(self) -> None:
        self.client = p.connect(p.DIRECT)
        self.bodies: dict[str, int] = {}

    def add_static(self, visual: VisualSpec, shapes: dict[str, Path]) -> None:
        kind, size = visual.shape.kind, visual.shape.size
        if kind == "box":
            shape = p.createVisualShape(p.GEOM_BOX, halfExtents=[s / 2 for s in size], physicsClientId=self.client)
        else:
            file = visual.shape.mesh if kind == "mesh" else str(shapes[kind])
            scale = {"mesh": size, "sphere": [size[0]] * 3, "cylinder": [size[0], size[0], size[1]]}[kind]
            shape = p.createVisualShape(p.GEOM_MESH, fileName=file, meshScale=scale, physicsClientId=self.client)
        pose = visual.pose
        self.bodies[visual.name] = p.createMultiBody(0, -1, shape, pose.position, pose.quat_xyzw, physicsClientId=self.client)

    def add_robot(self, robot: RobotSpec, urdf: Path, world: PhysicsWorld) -> None:
        base, joints = world.base_pose(robot.name), world.joint_states(robot.name)
        uid = p.loadURDF(str(urdf), base.position, base.quat_xyzw, physicsClientId=self.client)
        count = p.getNumJoints(uid, physicsClientId=self.client)
        numbers = {p.getJointInfo(uid, k, physicsClientId=self.client)[1].decode(): k for k in range(count)}
        for name, angle in zip(joints.names, joints.positions, strict=True):
            p.resetJointState(uid, numbers[name], angle, physicsClientId=self.client)
        self.bodies[robot.name] = uid

    def masks(self, camera: CameraSpec) -> dict[str, Mask]:
        """Returns the silhouette of each body, (H, W)."""
        w, h, k = camera.width, camera.height, camera.intrinsics()
        # Column i of PyBullet's image is taken half a pixel left of the middle of a pixel, row j half a pixel below it.
        cx, cy = k[0, 2] - 0.5, k[1, 2] + 0.5
        x, y = camera.near / k[0, 0], camera.near / k[1, 1]
        projection = p.computeProjectionMatrix(
            -(cx + 0.5) * x, (w - 0.5 - cx) * x, -(h - 0.5 - cy) * y, (cy + 0.5) * y, camera.near, camera.far
        )
        # OpenGL's camera looks along -z, and its y axis is up.
        view = np.diag([1.0, -1.0, -1.0, 1.0]) @ invert(matrix_from_pose(camera.pose))
        *_, segmentation = p.getCameraImage(
            w, h, view.T.ravel().tolist(), projection, shadow=0, renderer=p.ER_TINY_RENDERER, physicsClientId=self.client
        )
        numbers = np.reshape(segmentation, (h, w))
        return {name: numbers == uid for name, uid in self.bodies.items()}

    def centres_of_mass(self, state: SceneState) -> SceneState:
        """Returns the state with every link at its centre of mass, along its principal axes: PyBullet's frames."""
        positions, quats = state.positions.copy(), state.quats_xyzw.copy()
        for row, (body, _, link) in enumerate(name.partition("/") for name in state.links):
            uid = self.bodies[body]
            count = p.getNumJoints(uid, physicsClientId=self.client)
            numbers = {p.getJointInfo(uid, k, physicsClientId=self.client)[12].decode(): k for k in range(count)}
            if link in numbers:
                pose = p.getLinkState(uid, numbers[link], computeForwardKinematics=1, physicsClientId=self.client)
            else:
                pose = p.getBasePositionAndOrientation(uid, physicsClientId=self.client)
            positions[row], quats[row] = pose[:2]
        return replace(state, positions=positions, quats_xyzw=quats)


def _iou(a: Mask, b: Mask) -> float:
    return float((a & b).sum() / max((a | b).sum(), 1))


@pytest.fixture(scope="module")
def seen(root: Path, tmp_path_factory: pytest.TempPathFactory, egl: None) -> Iterator[dict[str, dict[str, Mask]]]:
    """Masks of all bodies: PyBullet's, ours, and ours with centres of mass for link frames."""
    folder = tmp_path_factory.mktemp("silhouettes")
    shapes = _unit_shapes(folder)
    (folder / "offset.urdf").write_text(OFFSET_URDF)
    (folder / "robot.yaml").write_text("urdf: offset.urdf\nradius: 0.3\nheight: 0.5\n")
    ball = bumpy_sphere(24, radius=0.18)
    mesh = _write_obj(folder / "bumpy.obj", ball.vertices.astype(float), ball.triangles.astype(np.int64))
    robots = (
        load_robot(root / "config/robots/gibson_bot", name="bot", start=pose_from_xyz_rpy((-0.55, 0.05, 0.1), (0.05, 0.1, 0.7))),
        load_robot(folder / "robot.yaml", name="offset", start=pose_from_xyz_rpy((0.1, -0.45, 0.1), (0.1, -0.1, 2.2))),
    )
    static = (
        VisualSpec("box", "", Shape("box", (0.4, 0.5, 0.3)), pose_from_xyz_rpy((0.7, 0.6, 0.2), (0.3, 0.2, 0.5))),
        VisualSpec("sphere", "", Shape("sphere", (0.2, 0.0, 0.0)), pose_from_xyz_rpy((0.5, 0.1, 0.35))),
        VisualSpec("tin", "", Shape("cylinder", (0.15, 0.3, 0.0)), pose_from_xyz_rpy((0.2, 0.55, 0.75), (0.8, 0.3, 0.0))),
        VisualSpec("mesh", "", Shape("mesh", (1.0, 1.2, 0.9), str(mesh)), pose_from_xyz_rpy((0.2, -0.2, 0.75), (0.0, 0.4, 0.2))),
    )
    scene = SceneSpec("test", folder, "", static, (), gravity=(0.0, 0.0, 0.0), robots=robots)
    reference = _Reference()
    with PhysicsWorld(scene) as world:
        # The arm swings, and the base swings back about the common centre of mass.
        world._bullet.drive_joints(world._robots["offset"].engine_body, [0], [2.0], [50.0])
        world.step(60)
        assert np.abs(world.joint_states("offset").positions).max() > 0.3
        for robot in robots:
            reference.add_robot(robot, _with_meshes(robot.urdf, shapes, folder / f"{robot.name}_meshes.urdf"), world)
        for visual in static:
            reference.add_static(visual, shapes)
        state, links = world.state(), world.links
    masks = {"PyBullet": reference.masks(CAMERA)}
    drawn = drawn_scene(scene, links)
    with Renderer(drawn) as renderer:
        assert not renderer.warnings
        for name, one in (("ours", state), ("centres of mass", reference.centres_of_mass(state))):
            image = renderer.render(one, [CAMERA])[0].instance
            masks[name] = {body: image == drawn.instances.index(body) for body in reference.bodies}
    yield masks
    p.disconnect(physicsClientId=reference.client)


BODIES = ("bot", "offset", "box", "sphere", "tin", "mesh")


@pytest.mark.parametrize("body", BODIES)
def test_silhouettes_agree_with_pybullets_renderer(seen: dict[str, dict[str, Mask]], body: str) -> None:
    theirs, ours = seen["PyBullet"][body], seen["ours"][body]
    assert theirs.sum() > 4_000
    assert _iou(ours, theirs) > 0.995


@pytest.mark.parametrize("body", ["bot", "offset"])
def test_centres_of_mass_in_place_of_link_frames_would_not_agree(seen: dict[str, dict[str, Mask]], body: str) -> None:
    assert _iou(seen["centres of mass"][body], seen["PyBullet"][body]) < 0.9
