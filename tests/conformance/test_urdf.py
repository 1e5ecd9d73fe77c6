"""URDF as urdfdom reads it, and xacro: what ``<robot>`` may hold is done, or named in a warning."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from conformance.rules import rule
from gibson_sim.description.rigid_groups import rigid_groups
from gibson_sim.description.urdf import UrdfJoint, UrdfLink, UrdfModel, parse_urdf, read_urdf
from gibson_sim.errors import RobotError
from gibson_sim.formats.load_mesh import MeshLoader
from gibson_sim.formats.textured_shapes import with_textures
from gibson_sim.geometry.transforms import matrix_from_quat
from gibson_sim.robots.load import load_robot
from gibson_sim.scenes.spawning import SpawnError, load_spawnable
from gibson_sim.types import Pose

BALL = '<geometry><sphere radius="0.1"/></geometry>'
LIMIT = '<limit lower="-1" upper="2" effort="3" velocity="4"/>'


def parse(body: str, attributes: str = 'name="r"', folder: Path = Path()) -> UrdfModel:
    """Returns the model of a ``<robot>`` with this content."""
    return parse_urdf(f"<robot {attributes}>{body}</robot>", folder / "r.urdf")


def link(inside: str, **arguments: Path) -> UrdfLink:
    """Returns the only link of a robot, and checks that nothing is warned of."""
    model = parse(f'<link name="a">{inside}</link>', **arguments)  # type: ignore[arg-type]
    assert model.warnings == ()
    return model.links[0]


def pair(kind: str, inside: str = "", more: str = "") -> UrdfModel:
    """Returns two links and the joint ``j`` between them."""
    ends = '<parent link="a"/><child link="b"/>'
    return parse(f'<link name="a"/><link name="b"/><joint name="j" type="{kind}">{ends}{inside}</joint>{more}')


def joint(kind: str, inside: str = "") -> UrdfJoint:
    """Returns the joint of ``pair``, and checks that nothing is warned of."""
    model = pair(kind, inside)
    assert model.warnings == ()
    return model.joints[0]


def refusal(body: str, attributes: str = 'name="r"') -> str:
    """Returns the error about a ``<robot>``, which is one line."""
    with pytest.raises(RobotError) as caught:
        parse(body, attributes)
    assert "\n" not in str(caught.value)
    return str(caught.value)


# <robot>


@rule("URDF", "<robot name>", "done")
def test_the_robot_has_its_name() -> None:
    assert parse('<link name="a"/>', 'name="my robot"').name == "my robot"


@rule("URDF", "<robot> without name", "approximated", "ROS refuses it; it is called after its file")
def test_a_robot_without_a_name_is_called_after_its_file() -> None:
    model = parse('<link name="a"/>', "")
    assert (model.name, model.warnings) == ("r", ("r.urdf: the <robot> has no name, which ROS refuses: it is called 'r'",))


@pytest.mark.parametrize("version", ["1.0", "1.1", "1.2"])
@rule("URDF", "<robot version>", "done", "1.0, 1.1 (`quat_xyzw`, capsules), 1.2 (limits of acceleration)")
def test_versions_that_are_published_need_no_warning(version: str) -> None:
    assert parse('<link name="a"/>', f'name="r" version="{version}"').warnings == ()


@rule("URDF", '<robot version="2.0">', "approximated", "read as 1.0")
def test_another_version_is_named() -> None:
    (warning,) = parse('<link name="a"/>', 'name="r" version="2.0"').warnings
    assert warning == "r.urdf: version '2.0' is read as 1.0; known: 1.0, 1.1, 1.2 (ROS refuses others)"


@rule("URDF", "another outermost element", "refused")
def test_root_element_other_than_robot_is_refused() -> None:
    with pytest.raises(RobotError, match=r"^\S+: the outermost element is <model>, must be <robot>$"):
        parse_urdf("<model/>", Path("r.urdf"))


@pytest.mark.parametrize("head", ["<?xml?>", '<?xml verison="1.0"?>', ' <?xml version="1.0"?>', ""])
@rule("URDF", "<?xml?> without a version, or after white space", "done", "as tinyxml2 reads it")
def test_the_declaration_of_xml_may_be_missing_or_empty(head: str) -> None:
    assert parse_urdf(f'{head}<robot name="r"><link name="a"/></robot>', Path("r.urdf")).root == "a"


@rule("URDF", "<robot xmlns>", "done", "not read, as in urdfdom")
def test_a_default_namespace_changes_nothing(tmp_path: Path) -> None:
    assert parse('<link name="a"/>', 'name="r" xmlns="http://www.ros.org"').root == "a"
    body = f'<link name="a"><visual>{BALL}</visual><collision>{BALL}</collision></link>'
    (tmp_path / "r.urdf").write_text(f'<robot name="r" xmlns="http://www.ros.org">{body}</robot>')
    (tmp_path / "robot.yaml").write_text("urdf: r.urdf\nbase_height: 0.5\n")
    assert load_robot(tmp_path / "robot.yaml").links == ("base_footprint", "a")


@rule("URDF", "no <link>", "refused")
def test_a_robot_without_links_is_refused() -> None:
    assert refusal("").endswith("r.urdf: has no <link>")


@rule("URDF", "two links or joints of one name", "refused")
def test_two_links_of_one_name_are_refused() -> None:
    assert "two links are named 'a'" in refusal('<link name="a"/><link name="a"/>')


@rule("URDF", "two roots", "refused")
def test_two_trees_are_refused() -> None:
    assert "has 2 root links (a, b)" in refusal('<link name="a"/><link name="b"/>')


@rule("URDF", "two parents of a link", "refused")
def test_a_link_with_two_parents_is_refused() -> None:
    with pytest.raises(RobotError, match="link 'b' has two parents, by joints 'j' and 'k'"):
        pair("fixed", more='<joint name="k" type="fixed"><parent link="a"/><child link="b"/></joint>')


@rule("URDF", "a cycle of joints", "refused")
def test_a_cycle_is_refused() -> None:
    with pytest.raises(RobotError, match="the joints form a cycle"):
        pair("fixed", more='<joint name="k" type="fixed"><parent link="b"/><child link="a"/></joint>')


@rule("URDF", "unknown elements", "left out", "each is named")
def test_elements_that_the_format_does_not_have_are_named() -> None:
    model = parse('<author/><link name="a"><colision/><colision/></link>')
    assert model.warnings == (
        "r.urdf: elements that URDF does not have are left out: <author> in <robot>, 2 <colision> in <link>",
    )


@rule("URDF", "unknown attributes", "left out", "each is named")
def test_attributes_that_the_format_does_not_have_are_named() -> None:
    shape = '<visual><origin ryp="0 0 1"/><geometry><sphere radius="1" color="red"/></geometry></visual>'
    model = parse(f'<link name="a">{shape}{shape}</link>')
    assert model.warnings == (
        "r.urdf: attributes that URDF does not have have no effect: 2 ryp of <origin>, 2 color of <sphere>",
    )


@rule(
    "URDF", "more than one of <inertial>, <geometry>, <origin>, <limit>, ...", "approximated", "the first counts, as in urdfdom"
)
def test_first_of_repeated_unique_elements_is_used() -> None:
    one, two = (
        f'<inertial><mass value="{kg}"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>' for kg in (1, 2)
    )
    shapes = '<visual><geometry><box size="1 1 1"/><sphere radius="1"/></geometry></visual>'
    model = parse(f'<link name="a">{one}{two}{shapes}</link>')
    assert (model.links[0].inertial.mass, model.links[0].visuals[0].shape.kind) == (1.0, "box")  # type: ignore[union-attr]
    assert model.warnings == (
        "r.urdf: only the first of several counts: 2 <inertial> in link 'a', 2 shapes in a <geometry> of link 'a'",
    )


# <link>


@rule("URDF", "<link name>", "refused", "refused without a name")
def test_a_link_without_a_name_is_refused() -> None:
    assert "a <link> has no name" in refusal("<link/>")


@rule("URDF", "<inertial>: <mass>, <origin xyz rpy>, <inertia>", "done")
def test_inertia_is_in_the_frame_of_its_origin() -> None:
    inertia = '<inertia ixx="1" ixy="0" ixz="0" iyy="2" iyz="0" izz="2.5"/>'
    turned = f'<inertial><origin xyz="0.1 0 0" rpy="0 0 {math.pi / 2}"/><mass value="3"/>{inertia}</inertial>'
    (group,), warnings = rigid_groups(parse(f'<link name="a">{turned}</link>'))
    assert warnings == ()
    assert (group.mass, *group.center) == pytest.approx((3.0, 0.1, 0.0, 0.0))
    assert np.diag(group.inertia) == pytest.approx([2.0, 1.0, 2.5])  # turned by 90 degrees about z, x and y change places


@rule("URDF", "<inertia ixy ixz iyz>", "done")
def test_products_of_inertia_are_used() -> None:
    inertia = '<inertia ixx="2" ixy="0.1" ixz="0.2" iyy="2" iyz="0.3" izz="2"/>'
    (group,), _ = rigid_groups(parse(f'<link name="a"><inertial><mass value="3"/>{inertia}</inertial></link>'))
    assert group.inertia == pytest.approx(np.array([[2, 0.1, 0.2], [0.1, 2, 0.3], [0.2, 0.3, 2]]))


@rule(
    "URDF",
    "an inertia that no body has",
    "approximated",
    "kept, with a warning; beyond 1.5 times the limit replaced by that of a small sphere",
)
def test_an_inertia_against_the_triangle_inequality_is_named() -> None:
    inertia = '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="2.5"/>'
    _, (warning,) = rigid_groups(parse(f'<link name="a"><inertial><mass value="3"/>{inertia}</inertial></link>'))
    assert "inertias that no body has" in warning
    assert "'a' (1, 1, 2.5 kg m^2)" in warning


@rule(
    "URDF",
    "no <inertial>, or a mass of 0, of a moving link",
    "approximated",
    "0.05 kg (a root: 1 kg), as the boxes around its shapes",
)
def test_a_moving_link_without_a_mass_gets_a_small_one() -> None:
    (_, moving), warnings = rigid_groups(pair("continuous"))
    assert moving.mass == 0.05
    assert "r.urdf: link 'b' has no mass; 0.05 kg is used" in warnings


@rule("URDF", "a mass or a moment of inertia below 0", "refused")
def test_a_negative_mass_is_refused() -> None:
    assert "mass is -1 kg, must not be negative" in refusal('<link name="a"><inertial><mass value="-1"/></inertial></link>')


@rule("URDF", "several <visual> and <collision> of a link", "done", "all, in the order of the file")
def test_all_visuals_and_collisions_are_read_in_order() -> None:
    sizes = [0.3, 0.1, 0.2]
    shapes = "".join(f'<visual><geometry><sphere radius="{r}"/></geometry></visual>' for r in sizes)
    shapes += "".join(f'<collision><geometry><sphere radius="{r}"/></geometry></collision>' for r in sizes)
    found = link(shapes)
    assert [v.shape.size[0] for v in found.visuals] == sizes
    assert [c.shape.size[0] for c in found.collisions] == sizes


@rule("URDF", "<visual name>, <collision name>", "done", "nothing refers to it")
def test_shapes_may_have_names() -> None:
    assert len(link(f'<visual name="v">{BALL}</visual><collision name="c">{BALL}</collision>').visuals) == 1


@rule("URDF", "<origin xyz rpy>", "done", "rpy: about fixed axes, x first")
def test_an_origin_turns_about_fixed_axes_roll_first() -> None:
    (visual,) = link(f'<visual><origin xyz="1 2 3" rpy="{math.pi / 2} 0 {math.pi / 2}"/>{BALL}</visual>').visuals
    assert visual.pose.position == (1.0, 2.0, 3.0)
    # y goes to z by the roll and stays there; x stays by the roll and goes to y by the yaw.
    assert matrix_from_quat(visual.pose.quat_xyzw)[:, :2] == pytest.approx(
        np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), abs=1e-12
    )


@rule("URDF", "<origin quat_xyzw>", "done", "URDF 1.1; normalised")
def test_an_origin_may_have_a_quaternion() -> None:
    (visual,) = link(f'<visual><origin quat_xyzw="0 0 2 2"/>{BALL}</visual>').visuals
    assert visual.pose.quat_xyzw == pytest.approx((0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5)))


@rule("URDF", "<origin> with rpy and quat_xyzw", "refused")
def test_two_rotations_of_an_origin_are_refused() -> None:
    text = refusal(f'<link name="a"><visual><origin rpy="0 0 0" quat_xyzw="0 0 0 1"/>{BALL}</visual></link>')
    assert text.endswith("<origin> has both rpy and quat_xyzw; give one of them")


@pytest.mark.parametrize("value", ["1 2", "1 2 3 4", "1 foo 3", "1 2.1.1 3", "1 nan 3", "1 1_0 3", ""])
@rule("URDF", "a vector that is not three finite numbers", "refused")
def test_a_vector_has_three_numbers(value: str) -> None:
    text = refusal(f'<link name="a"><visual><origin xyz="{value}"/>{BALL}</visual></link>')
    assert text.endswith(f'<origin xyz="{value}">, must be 3 finite numbers')


@rule(
    "URDF",
    "<box size>, <sphere radius>, <cylinder radius length>, <capsule radius length>",
    "done",
    "sizes are whole lengths; cylinders and capsules lie along z; the length of a capsule is that between its half spheres",
)
def test_shapes_have_their_sizes() -> None:
    texts = (
        '<box size="1 2 3"/>', '<sphere radius="4"/>', '<cylinder radius="5" length="6"/>', '<capsule radius="7" length="8"/>',
    )  # fmt: skip
    found = link("".join(f"<visual><geometry>{text}</geometry></visual>" for text in texts))
    shapes = [(v.shape.kind, v.shape.size) for v in found.visuals]
    assert shapes == [
        ("box", (1.0, 2.0, 3.0)), ("sphere", (4.0, 0.0, 0.0)), ("cylinder", (5.0, 6.0, 0.0)), ("capsule", (7.0, 8.0, 0.0)),
    ]  # fmt: skip


@rule("URDF", "a size of 0 or below", "refused")
def test_a_size_of_zero_is_refused() -> None:
    assert "must be above 0" in refusal('<link name="a"><visual><geometry><box size="1 0 1"/></geometry></visual></link>')


@rule("URDF", "<mesh filename scale>", "done", "`package://`, `file://`, or relative to the file; scale may mirror")
def test_a_mesh_is_found_and_scaled(tmp_path: Path) -> None:
    (tmp_path / "m.stl").write_bytes(b"")
    (visual,) = link('<visual><geometry><mesh filename="m.stl" scale="1 -2 3"/></geometry></visual>', folder=tmp_path).visuals
    assert (visual.shape.kind, visual.shape.size, visual.shape.mesh) == ("mesh", (1.0, -2.0, 3.0), str(tmp_path / "m.stl"))


@rule(
    "URDF",
    "<mesh> whose file is missing",
    "left out",
    "named; where all visuals of a link are missing, its collision shapes are drawn",
)
def test_a_missing_mesh_is_named() -> None:
    model = parse(
        f'<link name="a"><visual><geometry><mesh filename="package://p/m.stl"/></geometry></visual><collision>{BALL}</collision></link>'
    )
    assert model.links[0].visuals[0].shape.kind == "sphere"
    assert model.warnings == (
        "r.urdf: link 'a': visual: mesh package://p/m.stl does not exist; left out",
        "r.urdf: link 'a': its collision shapes are drawn, since it has no usable visual",
    )


@rule("URDF", "a shape of another kind", "left out", "named")
def test_an_unknown_shape_is_named() -> None:
    model = parse('<link name="a"><collision><geometry><cone/></geometry></collision></link>')
    assert (model.links[0].collisions, model.warnings) == (
        (),
        ("r.urdf: link 'a': collision: shape <cone> is not known; left out",),
    )


# <material>


@rule("URDF", "<material> of the robot, and by its name in a visual", "done")
def test_a_material_is_named_in_visuals() -> None:
    model = parse(
        f'<material name="m"><color rgba="1 0.5 0 0.25"/></material><link name="a"><visual>{BALL}<material name="m"/></visual></link>'
    )
    assert (model.links[0].visuals[0].color, model.warnings) == ((1.0, 0.5, 0.0, 0.25), ())


@rule("URDF", "<material> within a visual", "done", "its name is known to all other visuals")
def test_a_material_defined_in_one_visual_is_available_to_others() -> None:
    own = f'<visual>{BALL}<material name="m"><color rgba="1 0 0 1"/></material></visual>'
    assert [v.color for v in link(own + f'<visual>{BALL}<material name="m"/></visual>').visuals] == [(1.0, 0.0, 0.0, 1.0)] * 2


@rule("URDF", '<material name=""> within a visual', "done", "of this visual alone")
def test_unnamed_materials_apply_to_their_visual_only() -> None:
    texts = (f'<visual>{BALL}<material name=""><color rgba="{c} 0 0 1"/></material></visual>' for c in (1, 0))
    assert [v.color for v in link("".join(texts)).visuals] == [(1.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0, 1.0)]


@rule(
    "URDF",
    "two <material> of one name and different colours",
    "approximated",
    "the first counts, that of the robot before those in visuals, as in ROS",
)
def test_first_of_two_materials_with_one_name_is_used() -> None:
    own = f'<link name="a"><visual>{BALL}<material name="m"><color rgba="1 0 0 1"/></material></visual></link>'
    model = parse(own + '<material name="m"><color rgba="0 0 1 1"/></material>')
    assert model.links[0].visuals[0].color == (0.0, 0.0, 1.0, 1.0)
    assert model.warnings == ("r.urdf: materials are defined again with another colour; the first counts, as in ROS: 'm'",)


@rule("URDF", "<material> that is not defined", "left out", "named; drawn without a colour")
def test_a_material_that_is_not_defined_is_named() -> None:
    model = parse(f'<link name="a"><visual>{BALL}<material name="m"/></visual></link>')
    assert model.warnings == ("r.urdf: link 'a': material 'm' is not defined; drawn without a colour",)


@rule("URDF", "<color rgba> outside of 0 to 1", "approximated", "clipped")
def test_a_colour_in_255_steps_is_clipped_and_named() -> None:
    model = parse(f'<link name="a"><visual>{BALL}<material name=""><color rgba="255 0 0 1"/></material></visual></link>')
    assert (model.links[0].visuals[0].color, model.warnings) == (
        (1.0, 0.0, 0.0, 1.0), ("r.urdf: colours outside of 0 to 1 are clipped: '255 0 0 1'",),
    )  # fmt: skip


# <joint>


@pytest.mark.parametrize("kind", ["fixed", "continuous", "revolute", "prismatic"])
@rule("URDF", "<joint type>: fixed, continuous, revolute, prismatic", "done")
def test_joints_of_four_types_are_simulated(kind: str) -> None:
    assert joint(kind, LIMIT if kind in ("revolute", "prismatic") else "").kind == kind
    rigid_groups(pair(kind, LIMIT))


@pytest.mark.parametrize("kind", ["floating", "planar"])
@rule("URDF", "<joint type>: floating, planar", "refused", "read, but no robot or body may have one")
def test_floating_and_planar_joints_are_refused_as_not_simulated(tmp_path: Path, kind: str) -> None:
    assert joint(kind).kind == kind
    ends = '<parent link="a"/><child link="b"/>'
    (tmp_path / "r.urdf").write_text(
        f'<robot name="r"><link name="a"/><link name="b"/><joint name="j" type="{kind}">{ends}</joint></robot>'
    )
    (tmp_path / "robot.yaml").write_text("urdf: r.urdf\n")
    with pytest.raises(RobotError, match=f"joint 'j' is {kind}, which is not simulated"):
        load_robot(tmp_path / "robot.yaml")


@rule("URDF", "<joint> of another type", "refused")
def test_a_joint_of_an_unknown_type_is_refused() -> None:
    with pytest.raises(RobotError, match="has type 'ball', must be one of fixed, continuous"):
        pair("ball")


@rule("URDF", "<parent link>, <child link>", "refused", "refused if missing, or if the link does not exist")
def test_the_links_of_a_joint_must_exist() -> None:
    assert "joint 'j' names link 'z', which does not exist" in refusal(
        '<link name="a"/><joint name="j" type="fixed"><parent link="a"/><child link="z"/></joint>'
    )


@rule("URDF", "<joint>: <origin>", "done", "pose of the child in the parent at position 0")
def test_the_origin_of_a_joint_is_the_pose_of_its_child() -> None:
    got = pair("fixed", '<origin xyz="1 0 0" rpy="0 0 1.5707963267948966"/>').transforms()["b"]
    assert got == pytest.approx(np.array([[0, -1, 0, 1], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], dtype=float), abs=1e-12)


@rule("URDF", "<axis xyz>", "done", "1 0 0 if missing; normalised")
def test_an_axis_is_x_if_missing_and_has_length_one() -> None:
    assert joint("continuous").axis == (1.0, 0.0, 0.0)
    assert joint("continuous", '<axis xyz="0 3 4"/>').axis == pytest.approx((0.0, 0.6, 0.8))


@rule("URDF", "<axis> of a fixed or floating joint", "done", "not read, as in urdfdom")
def test_an_axis_of_a_fixed_joint_is_not_read() -> None:
    assert joint("fixed", '<axis xyz="0 0 0"/>').kind == "fixed"


@rule("URDF", '<axis xyz="0 0 0">', "refused")
def test_an_axis_without_a_direction_is_refused() -> None:
    with pytest.raises(RobotError, match="which is not a direction"):
        pair("continuous", '<axis xyz="0 0 0"/>')


@rule("URDF", "<limit lower upper effort velocity>", "done", "lower and upper: 0 if missing")
def test_limits_have_their_values() -> None:
    found = joint("revolute", LIMIT)
    assert (found.lower, found.upper, found.effort, found.velocity) == (-1.0, 2.0, 3.0, 4.0)
    closed = joint("prismatic", '<limit effort="3" velocity="4"/>')
    assert (closed.is_bounded, closed.lower, closed.upper) == (True, 0.0, 0.0)


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
@rule("URDF", "revolute or prismatic joint without <limit>", "approximated", "ROS refuses it; it moves without limits, from 0")
def test_a_joint_without_limits_is_named(kind: str) -> None:
    model = pair(kind)
    assert not model.joints[0].is_bounded
    assert model.warnings == (
        "r.urdf: revolute and prismatic joints without <limit>, which ROS refuses, move without limits, from 0: 'j'",
    )


@rule("URDF", "<limit> with lower above upper", "approximated", "moves without limits, from 0")
def test_limits_that_are_swapped_are_named() -> None:
    model = pair("revolute", '<limit lower="2" upper="-1" effort="3" velocity="4"/>')
    assert not model.joints[0].is_bounded
    assert model.warnings == (
        "r.urdf: joints whose lower limit is above the upper one move without limits, from 0; are they swapped?: 'j' (2 to -1)",
    )


@rule("URDF", "revolute joint with limits beyond 1000 rad", "approximated", "continuous: wheels are often described so")
def test_a_joint_with_limits_that_it_never_reaches_is_continuous() -> None:
    model = pair("revolute", '<limit lower="-1e16" upper="1e16" effort="3" velocity="4"/>')
    assert (model.joints[0].kind, model.joints[0].is_bounded, model.joints[0].effort) == ("continuous", False, 3.0)
    assert model.warnings == ("r.urdf: revolute joints with limits beyond 1000 rad are continuous: 'j'",)


@rule(
    "URDF",
    "<limit> without effort or velocity, or with 0",
    "approximated",
    "ROS refuses a missing one; 100 N m or N, 1 rad/s or m/s",
)
def test_a_missing_effort_is_named() -> None:
    model = pair("revolute", '<limit lower="-1" upper="2" velocity="4"/>')
    assert model.warnings == (
        "r.urdf: joints whose effort or velocity is missing or 0 in <limit> get the default of motors: 'j'",
    )


@rule("URDF", "<limit lower upper> of a continuous joint", "left out", "it turns without end")
def test_position_limits_of_a_continuous_joint_are_named() -> None:
    assert pair("continuous", LIMIT).warnings == (
        "r.urdf: continuous joints have no position limits; lower and upper are left out: 'j'",
    )


@rule("URDF", "<limit acceleration deceleration jerk>", "left out", "URDF 1.2; joints change their speed as their effort allows")
def test_limits_of_acceleration_are_named() -> None:
    (warning,) = pair("revolute", LIMIT.replace("/>", ' acceleration="5" jerk="6"/>')).warnings
    assert warning.endswith("limits left out: acceleration of 'j', jerk of 'j'")


@rule("URDF", "<dynamics damping friction>", "done")
def test_damping_and_friction_have_their_values() -> None:
    found = joint("continuous", '<dynamics damping="0.5" friction="0.25"/>')
    assert (found.damping, found.friction) == (0.5, 0.25)


@rule("URDF", "<mimic joint multiplier offset>", "done", "1 and 0 if missing")
def test_a_mimic_joint_follows_its_leader() -> None:
    links = "".join(f'<link name="{name}"/>' for name in "abc")
    leads = '<joint name="j" type="continuous"><parent link="a"/><child link="b"/></joint>'
    for inside, at in (("", 0.5), ('multiplier="2" offset="0.25"', 1.25)):
        follows = f'<joint name="k" type="continuous"><parent link="b"/><child link="c"/><mimic joint="j" {inside}/></joint>'
        assert parse(links + leads + follows).with_followers({"j": 0.5}) == {"j": 0.5, "k": at}


@rule("URDF", "<mimic> of a joint that does not exist", "refused")
def test_a_mimic_joint_without_a_leader_is_refused() -> None:
    with pytest.raises(RobotError, match="joint 'j' mimics 'k', which is not a movable joint"):
        pair("continuous", '<mimic joint="k"/>')


@pytest.mark.parametrize(
    ("inside", "why"),
    [
        ('<calibration rising="0.5"/>', "1 <calibration> (encoders know their zero)"),
        ('<safety_controller k_velocity="1"/>', "1 <safety_controller> (limits are those of <limit>)"),
    ],
)
@rule("URDF", "<calibration>, <safety_controller>", "left out", "encoders know their zero; limits are those of <limit>")
def test_calibration_and_safety_are_named(inside: str, why: str) -> None:
    assert pair("continuous", inside).warnings == (f"r.urdf: not simulated: {why}",)


# Extensions


@pytest.mark.parametrize(
    ("element", "why"),
    [
        ("<transmission/>", "1 <transmission> (motors turn the joints themselves, without gears)"),
        ("<ros2_control/>", "1 <ros2_control> (joints obey their own topics, without hardware interfaces)"),
        ("<sensor/>", "1 <sensor> (sensors are those of <gazebo> and of robot.yaml)"),
    ],
)
@rule(
    "URDF",
    "<transmission>, <ros2_control>, <sensor>",
    "left out",
    "joints obey their own topics; sensors are those of <gazebo> and robot.yaml",
)
def test_parts_of_a_robot_that_are_not_simulated_are_named(element: str, why: str) -> None:
    assert parse(f'<link name="a"/>{element}').warnings == (f"r.urdf: not simulated: {why}",)


@rule("URDF", "<gazebo>: mu1, mu2", "done", "Coulomb friction: the lower of both, at most 1.5")
def test_gazebo_friction_is_used() -> None:
    model = parse('<link name="a"/><gazebo reference="a"><mu1>0.8</mu1><mu2>0.6</mu2></gazebo>')
    assert (model.links[0].friction, model.warnings) == (0.6, ())


@rule(
    "URDF",
    "<gazebo>: <sensor>",
    "done",
    "camera, depth_camera, rgbd_camera, ray, lidar, gpu_lidar, imu: for robots without robot.yaml",
)
def test_sensors_for_gazebo_are_read() -> None:
    model = parse(
        '<link name="a"/><gazebo reference="a"><sensor name="s" type="imu"><update_rate>50</update_rate></sensor></gazebo>'
    )
    (sensor,) = model.gazebo.sensors
    assert (sensor.kind, sensor.rate_hz, model.warnings) == ("imu", 50.0, ())


@rule("URDF", "<gazebo>: other sensors, plugins, and properties (kp, kd, material, ...)", "left out", "named")
def test_gazebo_only_elements_are_named() -> None:
    inside = '<material>Gazebo/Red</material><kp>1e6</kp><sensor name="s" type="gps"/><plugin filename="libp.so"/>'
    assert parse(f'<link name="a"/><gazebo reference="a">{inside}</gazebo>').warnings == (
        "r.urdf: left out of <gazebo>, for Gazebo alone: <material>, <kp>, sensor 's' of type 'gps', plugin libp.so",
    )


@rule(
    "URDF",
    "<contact>: lateral_friction, rolling_friction, spinning_friction, stiffness, damping",
    "done",
    "an extension of Bullet",
)
def test_bullet_contact_properties_are_used() -> None:
    values = {"lateral_friction": 0.9, "rolling_friction": 0.01, "spinning_friction": 0.02, "stiffness": 1e4, "damping": 10.0}
    inside = "".join(f'<{key} value="{value}"/>' for key, value in values.items())
    found = link(f"<contact>{inside}</contact>")
    assert [
        found.friction, found.rolling_friction, found.spinning_friction, found.stiffness, found.contact_damping,
    ] == list(values.values())  # fmt: skip


# xacro


def expanded(folder: Path, body: str, robot_yaml: str = "") -> UrdfModel:
    """Returns the model that a robot with this xacro is loaded from."""
    header = '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">'
    wheels = "".join(
        f'<link name="{side}"><collision><geometry><sphere radius="0.1"/></geometry></collision></link>'
        f'<joint name="{side}_joint" type="continuous"><parent link="base"/><child link="{side}"/>'
        f'<origin xyz="0 {y} 0"/><axis xyz="0 1 0"/></joint>'
        for side, y in (("left", 0.2), ("right", -0.2))
    )
    (folder / "r.urdf.xacro").write_text(f"{header}{body}{wheels}</robot>")
    drive = "drive: {type: differential, left_joint: left_joint, right_joint: right_joint}\n"
    (folder / "robot.yaml").write_text(f"urdf: r.urdf.xacro\n{drive}radius: 0.3\nheight: 0.3\n{robot_yaml}")
    return read_urdf(load_robot(folder / "robot.yaml").urdf)


@pytest.fixture(autouse=True)
def _cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


def sphere(radius: str) -> str:
    return f'<collision><geometry><sphere radius="{radius}"/></geometry></collision>'


def radii(model: UrdfModel) -> list[float]:
    """Returns the radii of the spheres of the link ``base``."""
    return [round(collision.shape.size[0], 12) for collision in model.link("base").collisions]


@pytest.mark.parametrize(
    ("element", "body", "expected"),
    [
        ("property", f'<xacro:property name="r" value="0.1"/><link name="base">{sphere("${r}")}</link>', [0.1]),
        ("math", f'<xacro:property name="r" value="0.1"/><link name="base">{sphere("${2*r + cos(0) - 1}")}</link>', [0.2]),
        (
            "macro, default parameters",
            f'<xacro:macro name="m" params="r:=0.1 s">{sphere("${r}")}{sphere("${s}")}</xacro:macro>'
            '<link name="base"><xacro:m s="0.2"/><xacro:m r="0.3" s="0.4"/></link>',
            [0.1, 0.2, 0.3, 0.4],
        ),
        (
            "block parameters, insert_block",
            '<xacro:macro name="m" params="*shape **more"><xacro:insert_block name="shape"/><xacro:insert_block name="more"/></xacro:macro>'
            f'<link name="base"><xacro:m>{sphere("0.1")}<all>{sphere("0.2")}{sphere("0.3")}</all></xacro:m></link>',
            [0.1, 0.2, 0.3],
        ),
        (
            "if, unless",
            f'<link name="base"><xacro:if value="${{1 &lt; 2}}">{sphere("0.1")}</xacro:if>'
            f'<xacro:unless value="true">{sphere("0.2")}</xacro:unless></link>',
            [0.1],
        ),
        ("arg", f'<xacro:arg name="r" default="0.1"/><link name="base">{sphere("$(arg r)")}</link>', [0.1]),
    ],
)  # fmt: skip
@rule("URDF", "xacro: property, macro, default and block parameters, insert_block, if, unless, arg, math", "done")
def test_xacro_is_expanded(tmp_path: Path, element: str, body: str, expected: list[float]) -> None:
    assert radii(expanded(tmp_path, body)) == expected, element


@rule("URDF", "xacro: arguments", "done", "`xacro_args` of robot.yaml, `--xacro-arg NAME:=VALUE`")
def test_arguments_of_a_xacro_are_those_of_robot_yaml(tmp_path: Path) -> None:
    body = f'<xacro:arg name="r" default="0.1"/><link name="base">{sphere("$(arg r)")}</link>'
    assert radii(expanded(tmp_path, body, "xacro_args: {r: 0.25}\n")) == [0.25]


@rule("URDF", "xacro: include, $(find package), load_yaml", "done", "packages lie beside, in a workspace or in AMENT_PREFIX_PATH")
def test_files_of_packages_are_included(tmp_path: Path) -> None:
    package = tmp_path / "parts"
    package.mkdir()
    (package / "package.xml").write_text("<package><name>parts</name></package>")
    (package / "m.xacro").write_text(
        '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:property name="s" value="0.2"/></robot>'
    )
    (package / "sizes.yaml").write_text("wheel: {radius: 0.1}\n")
    body = (
        '<xacro:include filename="$(find parts)/m.xacro"/>'
        '<xacro:property name="sizes" value="${xacro.load_yaml(\'$(find parts)/sizes.yaml\')}"/>'
        f'<link name="base">{sphere("${sizes[&apos;wheel&apos;][&apos;radius&apos;]}")}{sphere("${s}")}</link>'
    )
    assert radii(expanded(tmp_path, body)) == [0.1, 0.2]


@rule("URDF", "xacro: include of a file or a package that is missing", "left out", "named; refused if the robot needs it")
def test_an_include_that_is_missing_is_named(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    body = f'<xacro:include filename="$(find nowhere)/m.xacro"/><link name="base">{sphere("0.1")}</link>'
    assert radii(expanded(tmp_path, body)) == [0.1]
    assert "package 'nowhere' is not found" in caplog.text


@rule("URDF", "xacro: an error in the file", "refused", "what xacro says, in one line")
def test_an_error_of_xacro_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(RobotError, match="name 'gone' is not defined") as caught:
        expanded(tmp_path, f'<link name="base">{sphere("${gone}")}</link>')
    assert "\n" not in str(caught.value)


@rule("URDF", "$(optenv NAME default)", "done", "the default, whatever the environment: a robot does not depend on the machine")
def test_an_optional_variable_has_its_default(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RADIUS", "0.5")
    model = parse(f'<link name="base">{sphere("$(optenv RADIUS 0.1)")}</link>')
    assert radii(model) == [0.1]


# <texture>


def textured(folder: Path, geometry: str) -> tuple[UrdfModel, NDArray[np.uint8] | None]:
    """Returns a model whose only visual has a texture, and the pixels of the texture that is drawn on it."""
    pixels = np.zeros((4, 4, 3), dtype=np.uint8)
    pixels[:2] = (10, 200, 30)
    Image.fromarray(pixels).save(folder / "wood.png")
    (folder / "flat.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (folder / "mapped.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n")
    material = '<material name="m"><color rgba="1 0 0 1"/><texture filename="wood.png"/></material>'
    body = f'<link name="a"><visual><geometry>{geometry}</geometry>{material}</visual></link>'
    model = with_textures(parse(body, folder=folder))
    (visual,) = model.links[0].visuals
    (part,) = MeshLoader(None).shape(visual.shape).parts
    return model, None if part.material.texture is None else part.material.texture.pixels


@pytest.mark.parametrize(
    "geometry",
    [
        '<box size="1 2 3"/>',
        '<sphere radius="1"/>',
        '<cylinder radius="1" length="2"/>',
        '<mesh filename="mapped.obj" scale="2 2 2"/>',
    ],
)
@rule(
    "URDF",
    "<texture filename>",
    "done",
    "on each side of a box, once around others; meshes by their coordinates; in place of a colour, as in RViz",
)
def test_a_texture_is_drawn(tmp_path: Path, geometry: str) -> None:
    model, pixels = textured(tmp_path, geometry)
    assert model.warnings == ()
    assert model.links[0].visuals[0].color is None
    assert pixels is not None
    assert pixels[:, 0, :3].tolist() == [[10, 200, 30]] * 2 + [[0, 0, 0]] * 2


def test_a_textured_shape_has_the_size_of_its_shape(tmp_path: Path) -> None:
    model, _ = textured(tmp_path, '<mesh filename="mapped.obj" scale="2 3 4"/>')
    (part,) = MeshLoader(None).shape(model.links[0].visuals[0].shape).parts
    assert part.vertices.max(axis=0) == pytest.approx([2.0, 3.0, 0.0])


@rule("URDF", "<texture> of a mesh without texture coordinates", "left out", "named; the colour is drawn")
def test_a_texture_of_a_mesh_without_coordinates_is_named(tmp_path: Path) -> None:
    model, pixels = textured(tmp_path, '<mesh filename="flat.obj"/>')
    assert pixels is None
    assert model.links[0].visuals[0].color == (1.0, 0.0, 0.0, 1.0)
    assert model.warnings == (f"r.urdf: texture {tmp_path / 'wood.png'} is left out: mesh 'flat.obj' has no texture coordinates",)


@rule("URDF", "<texture> whose file is missing", "left out", "named; the colour is drawn")
def test_a_missing_texture_is_named() -> None:
    material = '<material name="m"><color rgba="1 0 0 1"/><texture filename="gone.png"/></material>'
    model = parse(f'<link name="a"><visual>{BALL}{material}</visual></link>')
    assert model.links[0].visuals[0].color == (1.0, 0.0, 0.0, 1.0)
    assert model.warnings == ("r.urdf: texture gone.png does not exist; left out",)


def test_a_robot_and_a_spawned_body_have_their_textures(tmp_path: Path) -> None:
    Image.fromarray(np.zeros((2, 2, 3), dtype=np.uint8)).save(tmp_path / "wood.png")
    material = '<material name="m"><texture filename="wood.png"/></material>'
    (tmp_path / "r.urdf").write_text(
        f'<robot name="r"><link name="a"><visual>{BALL}{material}</visual><collision>{BALL}</collision></link></robot>'
    )
    (tmp_path / "robot.yaml").write_text("urdf: r.urdf\n")
    (drawn,) = load_robot(tmp_path / "robot.yaml").visuals
    body = load_spawnable(str(tmp_path / "r.urdf"), "", name="b", pose=Pose(), roots=(tmp_path,))
    assert [visual.shape.mesh for visual in body.visuals] == [drawn.shape.mesh]
    assert drawn.shape.mesh.endswith(".glb")
    (tmp_path / "inside").mkdir()
    (tmp_path / "inside" / "r.urdf").write_text((tmp_path / "r.urdf").read_text().replace("wood.png", "../wood.png"))
    with pytest.raises(SpawnError, match=r"wood\.png: lies outside"):
        load_spawnable(str(tmp_path / "inside" / "r.urdf"), "", name="b", pose=Pose(), roots=(tmp_path / "inside",))
