"""An SDF model as a tree of links: joints, masses, nested models."""

from __future__ import annotations

import math
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from gibson_sim.description.omissions import OmissionKind, kind_of
from gibson_sim.description.rigid_groups import rigid_groups
from gibson_sim.description.urdf import UrdfModel
from gibson_sim.errors import SceneError
from gibson_sim.formats.uris import UriResolver
from gibson_sim.scenes.builder import SceneBuilder
from gibson_sim.scenes.sdf.body import SdfBody, SdfBodyReader
from gibson_sim.scenes.sdf.elements import sdf_version
from gibson_sim.scenes.sdf.model import SdfModels

BOX = "<geometry><box><size>1 2 3</size></box></geometry>"
QUARTER = "1.5707963267948966"
TWO = '<link name="a"/><link name="b"><pose>1 0 0 0 0 0</pose></link>'


def _read(folder: Path, content: str, version: str = "1.6") -> SdfBody:
    path = folder / "m" / "model.sdf"
    path.parent.mkdir(exist_ok=True)
    path.write_text(f'<sdf version="{version}"><model name="m">{content}</model></sdf>')
    builder = SceneBuilder("m", path.parent, (folder,))
    top = ElementTree.parse(path).getroot()
    model = top.find("model")
    assert model is not None
    return SdfBodyReader(SdfModels(builder, UriResolver(folder, path.parent)), path).read(model, path.parent, sdf_version(top))


def _joint(kind: str = "revolute", inside: str = "", parent: str = "a", child: str = "b", name: str = "j") -> str:
    return f'<joint name="{name}" type="{kind}"><parent>{parent}</parent><child>{child}</child>{inside}</joint>'


def _axis(xyz: str, more: str = "", attributes: str = "") -> str:
    return f"<axis><xyz{attributes}>{xyz}</xyz>{more}</axis>"


def _links(model: UrdfModel) -> list[str]:
    return [link.name for link in model.links]


def _kinds(model: UrdfModel) -> set[OmissionKind]:
    return {kind_of(warning) for warning in model.warnings}


def test_root_is_first_and_child_is_where_its_pose_says(tmp_path: Path) -> None:
    model = _read(tmp_path, TWO + _joint(inside=_axis("0 0 1"))).model
    assert _links(model) == ["a", "b"]
    assert model.transforms()["b"][:3, 3] == pytest.approx([1.0, 0.0, 0.0])
    assert (model.name, model.joint("j").kind) == ("m", "continuous")


def test_limits_and_dynamics_are_read(tmp_path: Path) -> None:
    more = "<limit><lower>-1</lower><upper>2</upper><effort>5</effort><velocity>3</velocity></limit>"
    more += "<dynamics><damping>0.25</damping><friction>1.5</friction></dynamics>"
    got = _read(tmp_path, TWO + _joint(inside=_axis("0 2 0", more))).model.joint("j")
    assert (got.kind, got.lower, got.upper, got.effort, got.velocity) == ("revolute", -1.0, 2.0, 5.0, 3.0)
    assert (got.damping, got.friction) == (0.25, 1.5)
    assert got.axis == pytest.approx((0.0, 1.0, 0.0))


def test_limits_of_1e16_are_none(tmp_path: Path) -> None:
    more = "<limit><lower>-1e+16</lower><upper>1e+16</upper><effort>-1</effort><velocity>-1</velocity></limit>"
    got = _read(tmp_path, TWO + _joint(inside=_axis("0 0 1", more))).model.joint("j")
    assert (got.kind, got.effort, got.velocity) == ("continuous", 0.0, 0.0)


def test_drawer_without_limits_has_none(tmp_path: Path) -> None:
    got = _read(tmp_path, TWO + _joint("prismatic", _axis("1 0 0"))).model.joint("j")
    assert got.kind == "prismatic"
    assert got.lower > got.upper


TURNED = f'<link name="a"/><link name="b"><pose>1 0 0 0 0 {QUARTER}</pose></link>'


def test_axis_is_in_the_frame_of_the_joint(tmp_path: Path) -> None:
    # The joint is rotated by 90 degrees in b: its x is y of b.
    inside = f"<pose>0 0 0 0 0 {QUARTER}</pose>" + _axis("1 0 0")
    got = _read(tmp_path, TURNED + _joint("prismatic", inside)).model.joint("j")
    assert got.axis == pytest.approx((0.0, 1.0, 0.0))


@pytest.mark.parametrize(
    ("axis", "version"),
    [
        (_axis("1 0 0", "<use_parent_model_frame>1</use_parent_model_frame>"), "1.6"),
        (_axis("1 0 0", attributes=' expressed_in="__model__"'), "1.7"),
        (_axis("1 0 0", attributes=' expressed_in="a"'), "1.9"),
        (_axis("1 0 0"), "1.4"),
    ],
)
def test_axis_in_the_frame_of_the_model(tmp_path: Path, axis: str, version: str) -> None:
    # x of the model is -y of b, which is rotated by 90 degrees to the left.
    got = _read(tmp_path, TURNED + _joint("prismatic", axis), version).model.joint("j")
    assert got.axis == pytest.approx((0.0, -1.0, 0.0))


def test_hinge_beside_the_origin_of_a_door_keeps_the_frame_of_the_door(tmp_path: Path) -> None:
    # The door's origin is its middle, the hinge is 0.4 m to its right.
    door = f'<link name="a"/><link name="b"><pose>1 0 0 0 0 0</pose><collision name="c">{BOX}</collision></link>'
    model = _read(tmp_path, door + _joint(inside="<pose>0 -0.4 0 0 0 0</pose>" + _axis("0 0 1"))).model
    assert _links(model) == ["a", "j_axis", "b"]
    assert model.transforms()["j_axis"][:3, 3] == pytest.approx([1.0, -0.4, 0.0])
    assert model.transforms()["b"][:3, 3] == pytest.approx([1.0, 0.0, 0.0])
    assert (model.joint("j").child, model.joint("j_offset").kind) == ("j_axis", "fixed")
    # In physics both are one rigid body that turns about the hinge.
    groups, _ = rigid_groups(model)
    assert list(groups[1].members) == ["j_axis", "b"]


def test_joint_pose_relative_to_another_frame(tmp_path: Path) -> None:
    inside = '<pose relative_to="__model__">0 0 2 0 0 0</pose>' + _axis("0 0 1")
    model = _read(tmp_path, TWO + _joint(inside=inside), "1.7").model
    assert model.transforms()["j_axis"][:3, 3] == pytest.approx([0.0, 0.0, 2.0])


def test_mass_centre_and_inertia_are_read(tmp_path: Path) -> None:
    inertial = "<inertial><pose>0.1 0.2 0.3 0 0 0</pose><mass>4</mass><inertia><ixx>1</ixx><iyy>2</iyy><izz>2.5</izz>"
    model = _read(tmp_path, f'<link name="a">{inertial}<ixy>0.5</ixy></inertia></inertial></link>').model
    got = model.links[0].inertial
    assert got is not None
    assert (got.mass, got.pose.position, got.inertia) == (4.0, (0.1, 0.2, 0.3), (1.0, 0.5, 0.0, 2.0, 0.0, 2.5))


def test_inertia_that_is_not_given_is_that_of_the_standard(tmp_path: Path) -> None:
    model = _read(tmp_path, '<link name="a"><inertial><mass>4</mass></inertial></link>').model
    got = model.links[0].inertial
    assert got is not None
    assert got.inertia == (1.0, 0.0, 0.0, 1.0, 0.0, 1.0)


def test_friction_of_a_collision_is_that_of_the_link(tmp_path: Path) -> None:
    surface = "<surface><friction><ode><mu>0.85</mu></ode></friction></surface>"
    model = _read(tmp_path, f'<link name="a"><collision name="c">{BOX}{surface}</collision></link>').model
    assert model.links[0].friction == 0.85


def test_shapes_have_poses_in_their_link_and_colours(tmp_path: Path) -> None:
    material = "<material><diffuse>1 0 0 1</diffuse></material>"
    visual = f'<visual name="v"><pose>0 0 5 0 0 0</pose>{BOX}{material}</visual>'
    sphere = '<collision name="c"><geometry><sphere><radius>0.5</radius></sphere></geometry></collision>'
    link = f'<link name="b"><pose>1 0 0 0 0 0</pose>{visual}{sphere}</link>'
    got = _read(tmp_path, f'<link name="a"/>{link}' + _joint("fixed")).model.link("b")
    assert (got.visuals[0].pose.position, got.visuals[0].color) == ((0.0, 0.0, 5.0), (1.0, 0.0, 0.0, 1.0))
    assert (got.collisions[0].shape.kind, got.collisions[0].shape.size[0]) == ("sphere", 0.5)


def test_shape_relative_to_another_link(tmp_path: Path) -> None:
    visual = f'<visual name="v"><pose relative_to="a">0 0 5 0 0 0</pose>{BOX}</visual>'
    link = f'<link name="b"><pose>1 0 0 0 0 0</pose>{visual}</link>'
    got = _read(tmp_path, f'<link name="a"/>{link}' + _joint("fixed"), "1.7").model.link("b")
    assert got.visuals[0].pose.position == pytest.approx((-1.0, 0.0, 5.0))


def test_model_without_collisions_collides_as_it_is_drawn(tmp_path: Path) -> None:
    (link,) = _read(tmp_path, f'<link name="a"><visual name="v">{BOX}</visual></link>').model.links
    assert [c.shape for c in link.collisions] == [v.shape for v in link.visuals]


@pytest.mark.parametrize("flag", ["1", "true"])
def test_nothing_of_a_static_model_moves(tmp_path: Path, flag: str) -> None:
    body = _read(tmp_path, f"<static>{flag}</static>" + TWO + _joint(inside=_axis("0 0 1")))
    assert body.static
    assert body.model.joint("j").kind == "fixed"


def test_model_that_is_fixed_to_the_world_is_static_and_its_doors_move(tmp_path: Path) -> None:
    body = _read(tmp_path, TWO + _joint("fixed", parent="world", child="a", name="w") + _joint(inside=_axis("0 0 1")))
    assert body.static
    assert (_links(body.model), [joint.kind for joint in body.model.joints]) == (["a", "b"], ["continuous"])


def test_door_that_hangs_in_the_world(tmp_path: Path) -> None:
    body = _read(tmp_path, '<link name="a"/>' + _joint(inside=_axis("0 0 1"), parent="world", child="a"))
    assert body.static
    assert _links(body.model) == ["world", "a"]
    assert body.model.joint("j").parent == "world"


def test_root_is_where_the_frame_of_the_model_is(tmp_path: Path) -> None:
    model = _read(
        tmp_path, f'<pose>7 7 7 0 0 0</pose><link name="a"><pose>0 0 1 0 0 0</pose><visual name="v">{BOX}</visual></link>'
    ).model
    assert _links(model) == ["model_frame", "a"]
    assert model.transforms()["a"][:3, 3] == pytest.approx([0.0, 0.0, 1.0])


def test_links_that_no_joint_holds_are_fixed_with_a_warning(tmp_path: Path) -> None:
    model = _read(tmp_path, TWO).model
    assert [(joint.kind, joint.child) for joint in model.joints] == [("fixed", "b")]
    assert any("no joint connects b" in warning for warning in model.warnings)


def test_joint_that_closes_a_loop_is_left_out_with_a_warning(tmp_path: Path) -> None:
    model = _read(tmp_path, TWO + _joint("fixed") + _joint("fixed", parent="b", child="a", name="back")).model
    assert [joint.name for joint in model.joints] == ["j"]
    assert any("'back'" in warning and "loop" in warning for warning in model.warnings)


def test_joint_of_a_kind_that_is_not_simulated_does_not_move(tmp_path: Path) -> None:
    model = _read(tmp_path, TWO + _joint("ball")).model
    assert model.joint("j").kind == "fixed"
    assert any("'ball'" in warning for warning in model.warnings)


def test_nested_models_become_links_of_their_own_names(tmp_path: Path) -> None:
    inner = f'<model name="n"><pose>0 0 2 0 0 {QUARTER}</pose><link name="l"><pose>1 0 0 0 0 0</pose></link></model>'
    model = _read(tmp_path, f'<link name="a"/>{inner}' + _joint("fixed", child="n::l"), "1.7").model
    assert _links(model) == ["a", "n__l"]
    assert model.transforms()["n__l"][:3, 3] == pytest.approx([0.0, 1.0, 2.0])


def _model_beside(folder: Path, name: str, content: str) -> None:
    (folder / name).mkdir()
    (folder / name / "model.sdf").write_text(f'<sdf version="1.7"><model name="{name}">{content}</model></sdf>')


def test_included_model_is_placed_by_its_include(tmp_path: Path) -> None:
    _model_beside(tmp_path, "wheel", '<pose>9 9 9 0 0 0</pose><link name="l"><pose>0 0 1 0 0 0</pose></link>')
    include = "<include><uri>model://wheel</uri><name>left</name><pose>0 3 0 0 0 0</pose></include>"
    model = _read(tmp_path, f'<link name="a"/>{include}' + _joint("fixed", child="left::l")).model
    assert model.transforms()["left__l"][:3, 3] == pytest.approx([0.0, 3.0, 1.0])


def test_joint_to_a_whole_included_model_means_its_first_link(tmp_path: Path) -> None:
    _model_beside(tmp_path, "wheel", '<link name="l"/>')
    model = _read(tmp_path, '<link name="a"/><include><uri>model://wheel</uri></include>' + _joint("fixed", child="wheel")).model
    assert model.joint("j").child == "wheel__l"


def test_joint_to_a_frame_means_the_link_that_it_is_attached_to(tmp_path: Path) -> None:
    frame = '<frame name="f" attached_to="b"><pose>0 0 1 0 0 0</pose></frame>'
    inside = _axis("0 0 1")
    model = _read(tmp_path, TWO + frame + _joint(inside=inside, child="f"), "1.7").model
    assert model.joint("j_offset").child == "b"
    assert model.transforms()["j_axis"][:3, 3] == pytest.approx([1.0, 0.0, 1.0])


def test_model_that_includes_itself_is_named(tmp_path: Path) -> None:
    model = _read(tmp_path, '<link name="a"/><include><uri>model://m</uri></include>').model
    assert OmissionKind.INVALID in _kinds(model)
    assert any("includes itself" in warning for warning in model.warnings)


def test_missing_mesh_is_named_with_its_link(tmp_path: Path) -> None:
    mesh = "<geometry><mesh><uri>model://m/gone.obj</uri></mesh></geometry>"
    model = _read(tmp_path, f'<link name="a"><visual name="v">{mesh}</visual></link>').model
    assert _kinds(model) == {OmissionKind.MISSING_ASSET}
    assert any("link a" in warning and "gone.obj" in warning for warning in model.warnings)


@pytest.mark.parametrize(
    ("content", "value"),
    [
        ("<inertial><mass>nan</mass></inertial>", "nan"),
        ("<inertial><mass>much</mass></inertial>", "much"),
        ("<inertial><mass>1</mass><inertia><ixx>inf</ixx></inertia></inertial>", "inf"),
        ('<visual name="v"><geometry><box><size>1 -2 3</size></box></geometry></visual>', "-2"),
        ('<visual name="v"><geometry><sphere/></geometry></visual>', "nothing"),
        (f'<visual name="v"><pose>1 2 nan 0 0 0</pose>{BOX}</visual>', "nan"),
    ],
)
def test_impossible_values_are_named(tmp_path: Path, content: str, value: str) -> None:
    model = _read(tmp_path, f'<link name="a">{content}</link>').model
    assert OmissionKind.INVALID in _kinds(model)
    assert any(value in warning and "link a" in warning for warning in model.warnings)


@pytest.mark.parametrize("geometry", ["heightmap", "polyline"])
def test_geometry_that_cannot_be_read_is_named(tmp_path: Path, geometry: str) -> None:
    model = _read(tmp_path, f'<link name="a"><collision name="c"><geometry><{geometry}/></geometry></collision></link>').model
    assert _kinds(model) == {OmissionKind.UNSUPPORTED_ELEMENT}


PLANE = '<link name="a"><collision name="c"><geometry><plane><size>4 6</size></plane></geometry></collision></link>'


def test_plane_of_a_static_model_is_a_thin_box_below_it(tmp_path: Path) -> None:
    (collision,) = _read(tmp_path, "<static>1</static>" + PLANE).model.links[0].collisions
    assert collision.shape.size == (4.0, 6.0, 0.01)
    assert collision.pose.position == pytest.approx((0.0, 0.0, -0.005))


def test_plane_of_a_model_that_moves_is_not_supported(tmp_path: Path) -> None:
    model = _read(tmp_path, PLANE).model
    assert _kinds(model) == {OmissionKind.UNSUPPORTED_ELEMENT}


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("", "no <link>"),
        ('<link name="a"/><link name="a"/>', "'a'"),
        ("".join(f'<link name="l{k}"/>' for k in range(501)), "500 links"),
    ],
)
def test_invalid_models_are_refused(tmp_path: Path, content: str, words: str) -> None:
    with pytest.raises(SceneError, match=words):
        _read(tmp_path, content)


def test_frames_that_are_relative_to_each_other_are_named(tmp_path: Path) -> None:
    content = '<link name="a"><pose relative_to="b">1 0 0 0 0 0</pose></link><link name="b"><pose relative_to="a">1 0 0 0 0 0</pose></link>'
    assert OmissionKind.INVALID in _kinds(_read(tmp_path, content, "1.7").model)


def test_axes_of_rotated_links_are_unit_vectors(tmp_path: Path) -> None:
    link = '<link name="a"/><link name="b"><pose>0 0 0 0.3 0.4 0.5</pose></link>'
    got = _read(tmp_path, link + _joint(inside=_axis("1 1 0"))).model.joint("j")
    assert np.linalg.norm(got.axis) == pytest.approx(1.0)
    assert got.axis == pytest.approx((math.sqrt(0.5), math.sqrt(0.5), 0.0))
