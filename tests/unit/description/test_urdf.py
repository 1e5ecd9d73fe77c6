"""Reading URDF files."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.description.urdf import UrdfModel, read_urdf
from gibson_sim.errors import RobotError

Read = Callable[[str], UrdfModel]
TWO_LINKS = '<link name="a"/><link name="b"/>'


def joint(name: str = "j", kind: str = "fixed", parent: str = "a", child: str = "b", inside: str = "") -> str:
    return f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>{inside}</joint>'


def link(inside: str) -> str:
    return f'<link name="a">{inside}</link>'


@pytest.fixture
def read(tmp_path: Path) -> Read:
    def _read(body: str) -> UrdfModel:
        path = tmp_path / "urdf" / "r.urdf"
        path.parent.mkdir(exist_ok=True)
        path.write_text(f'<robot name="r">{body}</robot>', encoding="utf-8")
        return read_urdf(path)

    return _read


@pytest.mark.parametrize(("what", "body"), [("link", '<link name="{}"/>'), ("joint", TWO_LINKS + joint("{}"))])
def test_names_that_overflow_buffers_of_the_engine_are_refused(read: Read, what: str, body: str) -> None:
    assert read(body.format("n" * 500)).name == "r"
    with pytest.raises(RobotError, match=rf"{what} n+ \.\.\. n+ has a name of 501 bytes, at most 500 are allowed; shorten it"):
        read(body.format("n" * 501))


def test_root_comes_first_and_parents_before_children(read: Read) -> None:
    model = read('<link name="c"/><link name="b"/><link name="a"/>' + joint("j1", child="b") + joint("j2", parent="b", child="c"))
    assert [one.name for one in model.links] == ["a", "b", "c"]


def test_transform_of_a_turned_joint(read: Read) -> None:
    # b is 1 m ahead of a and rotated left by 90 degrees; c is 2 m ahead of b, hence to the left.
    body = '<link name="a"/><link name="b"/><link name="c"/>'
    body += joint("j1", inside=f'<origin xyz="1 0 0" rpy="0 0 {math.pi / 2}"/>')
    body += joint("j2", parent="b", child="c", inside='<origin xyz="2 0 0"/>')
    assert read(body).transforms()["c"][:3, 3] == pytest.approx([1.0, 2.0, 0.0])


def test_axis_is_normalised(read: Read) -> None:
    assert read(TWO_LINKS + joint(kind="continuous", inside='<axis xyz="0 0 -3"/>')).joint("j").axis == (0.0, 0.0, -1.0)


def test_limits_are_read(read: Read) -> None:
    limit = '<limit lower="-1" upper="2" effort="3" velocity="4"/>'
    got = read(TWO_LINKS + joint(kind="revolute", inside=limit)).joint("j")
    assert (got.lower, got.upper, got.effort, got.velocity) == (-1.0, 2.0, 3.0, 4.0)


def test_frictions_of_a_link_are_read(read: Read) -> None:
    one = '<contact><lateral_friction value="0.7"/><rolling_friction value="0.002"/><spinning_friction value="0.001"/></contact>'
    (found,) = read(link(one)).links
    assert (found.friction, found.rolling_friction, found.spinning_friction) == (0.7, 0.002, 0.001)
    (bare,) = read(link("")).links
    assert (bare.friction, bare.rolling_friction, bare.spinning_friction) == (None, 0.0, 0.0)
    with pytest.raises(RobotError, match="rolling_friction is -1"):
        read(link('<contact><rolling_friction value="-1"/></contact>'))


def test_stiffness_of_a_link_and_friction_of_a_joint_are_read(read: Read) -> None:
    (found,) = read(link('<contact><stiffness value="1e6"/><damping value="1e4"/></contact>')).links
    assert (found.stiffness, found.contact_damping) == (1e6, 1e4)
    got = read(TWO_LINKS + joint(kind="revolute", inside='<dynamics damping="0.5" friction="1.5"/>')).joint("j")
    assert (got.damping, got.friction) == (0.5, 1.5)
    assert read(TWO_LINKS + joint(kind="revolute")).joint("j").friction == 0.0


def test_shapes_and_sizes(read: Read) -> None:
    shapes = '<box size="1 2 3"/>', '<sphere radius="4"/>', '<cylinder radius="5" length="6"/>'
    model = read(link("".join(f"<collision><geometry>{shape}</geometry></collision>" for shape in shapes)))
    got = [(c.shape.kind, c.shape.size) for c in model.link("a").collisions]
    assert got == [("box", (1.0, 2.0, 3.0)), ("sphere", (4.0, 0.0, 0.0)), ("cylinder", (5.0, 6.0, 0.0))]


def test_colour_of_a_global_material(read: Read) -> None:
    visual = '<visual><geometry><sphere radius="1"/></geometry><material name="red"/></visual>'
    model = read('<material name="red"><color rgba="1 0.25 0 0.5"/></material>' + link(visual))
    assert model.link("a").visuals[0].color == (1.0, 0.25, 0.0, 0.5)


def test_mesh_relative_to_the_file(read: Read, tmp_path: Path) -> None:
    (tmp_path / "m.stl").write_bytes(b"x")
    model = read(link('<visual><geometry><mesh filename="../m.stl" scale="0.1 0.2 0.3"/></geometry></visual>'))
    shape = model.link("a").visuals[0].shape
    assert (shape.mesh, shape.size) == (str(tmp_path / "m.stl"), (0.1, 0.2, 0.3))


def test_mesh_of_a_package_above_the_file(read: Read, tmp_path: Path) -> None:
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "m.stl").write_bytes(b"x")
    model = read(link(f'<visual><geometry><mesh filename="package://{tmp_path.name}/meshes/m.stl"/></geometry></visual>'))
    assert model.link("a").visuals[0].shape.mesh == str(tmp_path / "meshes" / "m.stl")


def test_missing_visual_mesh_is_left_out_with_a_warning(read: Read) -> None:
    model = read(link('<visual><geometry><mesh filename="gone.dae"/></geometry></visual>'))
    assert model.link("a").visuals == ()
    assert "gone.dae" in model.warnings[0]


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("", "no <link>"),
        (TWO_LINKS, "2 root links (a, b)"),
        (
            "".join(f'<link name="l{k}"/>' for k in range(900)),
            "900 root links (l0, l1, l2, l3, l4, l5, l6, l7 and 892 more); connect",
        ),
        (TWO_LINKS + joint() + joint("k", parent="b", child="a"), "cycle"),
        (
            '<link name="c"/>' + TWO_LINKS + joint() + joint("k", parent="b", child="a"),
            "cycle",
        ),
        (TWO_LINKS + joint() + joint("k"), "two parents"),
        (TWO_LINKS + joint(child="x"), "link 'x'"),
        (TWO_LINKS + joint(kind="screw"), "'screw'"),
        (TWO_LINKS + joint() + '<link name="a"/>', "named 'a'"),
        (TWO_LINKS + joint(kind="continuous", inside='<axis xyz="0 0 0"/>'), "not a direction"),
        (link('<collision><geometry><sphere radius="-1"/></geometry></collision>'), "above 0"),
        (link('<inertial><mass value="heavy"/></inertial>'), "heavy"),
        (link('<collision><origin xyz="0 nan 0"/><geometry><sphere radius="1"/></geometry></collision>'), "finite"),
        (link('<collision><origin xyz="0 0"/><geometry><sphere radius="1"/></geometry></collision>'), "3 finite numbers"),
    ],
)
def test_broken_description_is_refused_in_one_line(read: Read, body: str, words: str) -> None:
    with pytest.raises(RobotError) as error:
        read(body)
    assert words in str(error.value)
    assert "\n" not in str(error.value)


def test_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RobotError, match="no URDF at"):
        read_urdf(tmp_path / "none.urdf")


def test_broken_xml_is_refused(tmp_path: Path) -> None:
    (tmp_path / "r.urdf").write_text("<robot>")
    with pytest.raises(RobotError, match="is not well-formed XML"):
        read_urdf(tmp_path / "r.urdf")


def test_xacro_is_refused_with_the_remedy(tmp_path: Path) -> None:
    (tmp_path / "r.urdf").write_text(
        '<robot name="r" xmlns:xacro="http://ros.org/wiki/xacro"><xacro:include filename="x"/></robot>'
    )
    with pytest.raises(RobotError, match=r"xacro r\.urdf >"):
        read_urdf(tmp_path / "r.urdf")


@pytest.mark.parametrize(
    "text",
    [
        "<robot name='r' xmlns:xacro='x'><link name='a'/><xacro:include filename='wheels.xacro'/></robot>",
        "<robot name='r' xmlns:xacro='x'><link name='a'/><xacro:wheel side='left'/></robot>",
        "<robot name='r'><link name='a'/><xacro:wheel side='left'/></robot>",
    ],
    ids=["include", "macro", "without a namespace"],
)
def test_elements_of_xacro_are_refused_whatever_their_namespace(tmp_path: Path, text: str) -> None:
    (tmp_path / "r.urdf").write_text(text)
    with pytest.raises(RobotError, match=r"expand it first: xacro r\.urdf > robot\.urdf"):
        read_urdf(tmp_path / "r.urdf")


def test_xacro_remains_in_a_comment_are_ignored(tmp_path: Path) -> None:
    (tmp_path / "r.urdf").write_text("<?x <xacro:a?><robot name='r'><!-- <xacro:include/> --><link name='a'/></robot>")
    assert read_urdf(tmp_path / "r.urdf").root == "a"


def test_real_turtlebot3_is_read(data_dir: Path) -> None:
    model = read_urdf(data_dir / "nav2_minimal_tb3_tb4/nav2_minimal_tb3_sim/urdf/turtlebot3_waffle.urdf")
    assert model.warnings == ()
    assert (model.root, len(model.links), len(model.joints)) == ("base_footprint", 13, 12)
    # base_joint 0.010 and scan_joint (-0.064, 0, 0.122)
    assert model.transforms()["base_scan"][:3, 3] == pytest.approx([-0.064, 0.0, 0.132])
    left = model.joint("wheel_left_joint")
    # Its z axis, turned by rpy (-1.57, 0, 0), points along +y of the base.
    assert model.transforms()["wheel_left_link"][:3, :3] @ np.array(left.axis) == pytest.approx([0.0, 1.0, 0.0], abs=1e-3)
    assert model.link("base_link").visuals[0].shape.mesh.endswith("waffle_base.dae")
