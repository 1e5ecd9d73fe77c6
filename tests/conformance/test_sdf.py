"""SDF 1.4 to 1.12: each element is read as the specification says, or a warning names what is left out."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from conformance.rules import rule
from gibson_sim.formats.uris import UriResolver
from gibson_sim.geometry.transforms import Mat4, matrix_from_pose, pose_from_xyz_rpy
from gibson_sim.scenes.builder import SceneBuilder
from gibson_sim.scenes.load import load_scene
from gibson_sim.scenes.sdf.body import SdfBody, SdfBodyReader
from gibson_sim.scenes.sdf.elements import sdf_version
from gibson_sim.scenes.sdf.model import SdfModels
from gibson_sim.scenes.sdf.scopes import Scope
from gibson_sim.scenes.spec import SceneSpec

FORMAT = "SDF"
QUARTER = "1.5707963267948966"
BOX = "<geometry><box><size>1 2 3</size></box></geometry>"
VISUAL = f'<visual name="v">{BOX}</visual>'


@pytest.fixture(autouse=True)
def _no_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Tests see no models of the user."""
    for name in ("GZ_SIM_RESOURCE_PATH", "GAZEBO_MODEL_PATH", "SDF_PATH", "IGN_GAZEBO_RESOURCE_PATH"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("GZ_FUEL_CACHE_PATH", str(tmp_path / "no_cache"))
    monkeypatch.setenv("IGN_FUEL_CACHE_PATH", str(tmp_path / "no_cache"))


def world(folder: Path, content: str, version: str = "1.10", *, lamps: bool = False) -> SceneSpec:
    """Returns the scene of a world; models lie in ``models``."""
    path = folder / "scene" / "worlds" / "w.sdf"
    path.parent.mkdir(parents=True, exist_ok=True)
    (folder / "scene" / "models").mkdir(exist_ok=True)
    path.write_text(f'<sdf version="{version}"><world name="w">{content}</world></sdf>')
    return load_scene(path, sdf_lamps=lamps)


def model(folder: Path, name: str, content: str, version: str = "1.10", attributes: str = "") -> None:
    """Writes a model that worlds and bodies can include."""
    path = folder / "scene" / "models" / name / "model.sdf"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f'<sdf version="{version}"><model name="{name}"{attributes}>{content}</model></sdf>')


def body(folder: Path, content: str, version: str = "1.10", attributes: str = "") -> SdfBody:
    """Returns a model as a body."""
    model(folder, "m", content, version, attributes)
    path = folder / "scene" / "models" / "m" / "model.sdf"
    builder = SceneBuilder("m", path.parent, (folder,))
    root = ElementTree.parse(path).getroot()
    top = root.find("model")
    assert top is not None
    uris = UriResolver(folder / "scene", path.parent)
    return SdfBodyReader(SdfModels(builder, uris), path).read(top, path.parent, sdf_version(root))


def scope(content: str, version: str = "1.10") -> tuple[Scope, list[str]]:
    """Returns the scope of a model without files, and its warnings."""
    builder = SceneBuilder("m", Path("/nowhere"), ())
    top = ElementTree.fromstring(f'<model name="m">{content}</model>')
    models = SdfModels(builder, UriResolver(Path("/nowhere"), Path("/nowhere")))
    return models.scope(top, "m", Path("/nowhere"), tuple(map(int, version.split(".")))), builder.warnings  # type: ignore[return-value]


def at(x: float, y: float, z: float, roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0) -> Mat4:
    return matrix_from_pose(pose_from_xyz_rpy((x, y, z), (roll, pitch, yaw)))


def places(scene: SceneSpec) -> list[tuple[float, float, float]]:
    return [tuple(round(c, 9) + 0.0 for c in v.pose.position) for v in scene.visuals]  # type: ignore[misc]


def warned(warnings: tuple[str, ...] | list[str], *words: str) -> bool:
    """Returns whether one warning has all words."""
    return any(all(word in line for word in words) for line in warnings)


# Poses


@rule(FORMAT, "<pose>", "done", "six numbers, radians; fixed axes roll, pitch, yaw")
@rule(FORMAT, "pose[degrees]", "done")
@rule(FORMAT, 'pose[rotation_format="quat_xyzw"]', "done")
@pytest.mark.parametrize(
    "pose",
    [
        "<pose>1 2 3 0.1 0.2 0.3</pose>",
        f'<pose degrees="true">1 2 3 {math.degrees(0.1)!r} {math.degrees(0.2)!r} {math.degrees(0.3)!r}</pose>',
        '<pose rotation_format="quat_xyzw">1 2 3 {} {} {} {}</pose>',
    ],
)
def test_rotations_are_angles_degrees_or_quaternions(pose: str) -> None:
    quat = pose_from_xyz_rpy((0.0, 0.0, 0.0), (0.1, 0.2, 0.3)).quat_xyzw
    found, warnings = scope(f'<link name="a">{pose.format(*map(repr, quat))}</link>')
    np.testing.assert_allclose(found.pose("a"), at(1, 2, 3, 0.1, 0.2, 0.3), atol=1e-12)
    assert not warnings


@rule(
    FORMAT,
    "<pose>",
    "refused",
    "values that are no numbers, or not six (seven) of them: zero is used in a world, a body is refused",
)
@pytest.mark.parametrize(
    "pose", ["<pose>1 2</pose>", "<pose>a b c d e f</pose>", '<pose rotation_format="quat_xyzw">1 2 3 0 0 0</pose>']
)
def test_a_pose_of_the_wrong_count_is_named(pose: str) -> None:
    found, warnings = scope(f'<link name="a">{pose}</link>')
    np.testing.assert_array_equal(found.pose("a"), np.eye(4))
    assert warned(warnings, "link a", "<pose>")


@rule(FORMAT, "pose[relative_to]", "done", "links, joints, frames and nested models of the same model, and those in nested ones")
def test_poses_are_relative_to_frames_of_their_scope() -> None:
    found, warnings = scope(
        f'<link name="a"><pose>1 0 0 0 0 {QUARTER}</pose></link><link name="b"><pose relative_to="a">1 0 0 0 0 0</pose></link>'
        '<frame name="f" attached_to="b"><pose>0 0 1 0 0 0</pose></frame><link name="c"><pose relative_to="f">0 0 1 0 0 0</pose></link>'
        '<model name="n"><pose relative_to="b">0 0 5 0 0 0</pose><link name="l"><pose>0 1 0 0 0 0</pose></link></model>'
        '<frame name="g"><pose relative_to="n::l">0 0 0 0 0 0</pose></frame>'
    )
    quarter = math.pi / 2
    np.testing.assert_allclose(found.pose("b"), at(1, 1, 0, yaw=quarter), atol=1e-12)
    np.testing.assert_allclose(found.pose("c"), at(1, 1, 2, yaw=quarter), atol=1e-12)
    np.testing.assert_allclose(found.pose("g"), at(0, 1, 5, yaw=quarter), atol=1e-12)
    assert not warnings


@rule(FORMAT, "pose[frame]", "done", "SDF 1.5 and 1.6: the same as `relative_to`")
def test_the_frame_of_older_versions_is_what_the_pose_is_relative_to() -> None:
    found, _ = scope(
        '<link name="a"><pose>1 0 0 0 0 0</pose></link><link name="b"><pose frame="a">1 0 0 0 0 0</pose></link>', "1.6"
    )
    np.testing.assert_allclose(found.pose("b"), at(2, 0, 0))


@rule(FORMAT, "scopes of names", "done", "a link with the name of its model is that link; `__model__` is the model")
def test_a_name_means_the_link_of_the_scope_not_the_model_around_it() -> None:
    found, warnings = scope(
        '<link name="m"><pose>1 0 0 0 0 0</pose></link><link name="b"><pose relative_to="m">1 0 0 0 0 0</pose></link>'
        '<link name="c"><pose relative_to="__model__">5 0 0 0 0 0</pose></link>'
    )
    np.testing.assert_allclose(found.pose("b"), at(2, 0, 0))
    np.testing.assert_allclose(found.pose("c"), at(5, 0, 0))
    assert not warnings


@rule(
    FORMAT, "pose[relative_to]", "refused", "an unknown name, or a cycle: the model's frame is used in a world, a body is refused"
)
@pytest.mark.parametrize(
    "content",
    [
        '<link name="a"><pose relative_to="m">1 0 0 0 0 0</pose></link>',
        '<link name="a"><pose relative_to="a">1 0 0 0 0 0</pose></link>',
        '<link name="a"><pose relative_to="b">1 0 0 0 0 0</pose></link><link name="b"><pose relative_to="a">1 0 0 0 0 0</pose></link>',
    ],
)
def test_unknown_frames_and_cycles_are_named(content: str) -> None:
    found, warnings = scope(content)
    found.pose("a")
    assert warned(warnings, "model m", "frame")


@rule(FORMAT, "<frame>", "done", "`attached_to` is what its pose is relative to, unless `relative_to` is given")
def test_a_frame_has_the_pose_of_what_it_is_attached_to() -> None:
    found, _ = scope(
        '<link name="a"><pose>1 0 0 0 0 0</pose></link><link name="b"><pose>0 5 0 0 0 0</pose></link>'
        '<frame name="f" attached_to="a"/><frame name="g" attached_to="f"><pose>1 0 0 0 0 0</pose></frame>'
        '<frame name="h" attached_to="a"><pose relative_to="b">1 0 0 0 0 0</pose></frame>'
    )
    np.testing.assert_allclose(found.pose("g"), at(2, 0, 0))
    np.testing.assert_allclose(found.pose("h"), at(1, 5, 0))
    assert found.link_of("g") is not None
    assert found.link_of("h")[1].get("name") == "a"  # type: ignore[index]


@rule(FORMAT, "model[canonical_link]", "done", "else the first link, else that of the first nested model")
@pytest.mark.parametrize(("attribute", "link"), [("", "a"), (' canonical_link="b"', "b"), (' canonical_link="n::c"', "c")])
def test_joints_to_a_model_mean_its_canonical_link(tmp_path: Path, attribute: str, link: str) -> None:
    inner = f'<model name="i"{attribute}><model name="n"><link name="c"/></model><link name="a"/><link name="b"/></model>'
    joint = '<joint name="j" type="fixed"><parent>root</parent><child>i</child></joint>'
    got = body(tmp_path, f'<link name="root"/>{inner}{joint}').model
    assert got.joint("j").child == {"a": "i__a", "b": "i__b", "c": "i__n__c"}[link]


@rule(FORMAT, "model[placement_frame]", "done", "of a model in a world, a nested model and an included one")
@pytest.mark.parametrize("nested", [False, True])
def test_the_placement_frame_is_where_the_pose_of_the_model_is(tmp_path: Path, nested: bool) -> None:
    inner = (
        f'<model name="n" placement_frame="f"><pose>5 0 0 0 0 0</pose><link name="l">{VISUAL}</link>'
        f'<frame name="f"><pose>1 2 0 0 0 {QUARTER}</pose></frame></model>'
    )
    scene = world(tmp_path, f'<model name="o">{inner}</model>' if nested else inner)
    # f is at (5, 0, 0) with the world's axes, so the model is turned by -90 degrees: its origin is (-1, -2) of f, turned: (-2, 1).
    assert places(scene) == [(3.0, 1.0, 0.0)]


@rule(FORMAT, "include/placement_frame", "done")
@rule(FORMAT, "include/pose", "done", "also relative to a frame, a link or a nested model")
def test_an_include_places_a_frame_of_its_model(tmp_path: Path) -> None:
    model(tmp_path, "n", f'<link name="l">{VISUAL}</link><frame name="f"><pose>1 0 0 0 0 0</pose></frame>')
    include = (
        '<include><uri>model://n</uri><placement_frame>f</placement_frame><pose relative_to="g">0 0 0 0 0 0</pose></include>'
    )
    assert places(world(tmp_path, f'<frame name="g"><pose>7 0 0 0 0 0</pose></frame>{include}')) == [(6.0, 0.0, 0.0)]


@rule(FORMAT, "include/placement_frame", "refused", "without a <pose>: it has no effect in a world, a body is refused")
def test_a_placement_frame_without_a_pose_is_named(tmp_path: Path) -> None:
    model(tmp_path, "n", f'<link name="l">{VISUAL}</link><frame name="f"><pose>1 0 0 0 0 0</pose></frame>')
    scene = world(tmp_path, "<include><uri>model://n</uri><placement_frame>f</placement_frame></include>")
    assert warned(scene.warnings, "<placement_frame> needs a <pose>")


@rule(FORMAT, "<include>", "done", "frames of an included model are `name::frame`")
def test_poses_are_relative_to_links_of_included_models(tmp_path: Path) -> None:
    model(tmp_path, "arm", '<link name="hand"><pose>0 0 2 0 0 0</pose></link>')
    include = "<include><uri>model://arm</uri><name>inc</name><pose>1 0 0 0 0 0</pose></include>"
    content = f'{include}<link name="cup"><pose relative_to="inc::hand">0 0 1 0 0 0</pose>{VISUAL}</link>'
    scene = world(tmp_path, f'<model name="o">{content}</model>')
    assert places(scene) == [(1.0, 0.0, 3.0)]
    assert not scene.warnings
    got = body(tmp_path, content).model
    np.testing.assert_allclose(got.transforms()["cup"], at(1, 0, 3), atol=1e-12)


@rule(FORMAT, 'include[merge="true"]', "done", "links, joints, frames and models become those of the including model")
def test_a_merged_model_is_part_of_the_including_one(tmp_path: Path) -> None:
    inner = f'<link name="a"><pose>1 0 0 0 0 0</pose>{VISUAL}</link><frame name="f"><pose relative_to="__model__">0 1 0 0 0 0</pose></frame>'
    model(tmp_path, "part", inner)
    include = f'<include merge="true"><uri>model://part</uri><pose>0 0 3 0 0 {QUARTER}</pose></include>'
    content = f'{include}<link name="b"><pose relative_to="f">0 0 1 0 0 0</pose>{VISUAL}</link>'
    scene = world(tmp_path, f'<model name="o">{content}</model>')
    # a: (1, 0) turned to (0, 1); f: (0, 1) turned to (-1, 0).
    assert places(scene) == [(0.0, 1.0, 3.0), (-1.0, 0.0, 4.0)]
    got = body(tmp_path, content).model
    assert {link.name for link in got.links} >= {"a", "b"}


@rule(FORMAT, 'include[merge="true"]', "done", "with a <placement_frame>, too")
def test_a_merged_model_is_placed_by_its_placement_frame(tmp_path: Path) -> None:
    model(tmp_path, "part", f'<link name="a"><pose>1 0 0 0 0 0</pose>{VISUAL}</link>')
    include = (
        '<include merge="true"><uri>model://part</uri><placement_frame>a</placement_frame><pose>5 0 0 0 0 0</pose></include>'
    )
    assert places(world(tmp_path, f'<model name="o">{include}</model>')) == [(5.0, 0.0, 0.0)]


@rule(FORMAT, "include/experimental:params", "left out", "the included model is that of the file")
def test_parameters_of_an_include_are_named(tmp_path: Path) -> None:
    model(tmp_path, "n", f'<link name="l">{VISUAL}</link>')
    params = '<experimental:params xmlns:experimental="urn:e"><link element_id="l" action="remove"/></experimental:params>'
    scene = world(tmp_path, f"<include><uri>model://n</uri>{params}</include>")
    assert warned(scene.warnings, "parameters of its <include> are not applied")


@rule(FORMAT, "joint/pose", "done", "relative to its child by default")
@rule(FORMAT, "names of several kinds", "done", "until SDF 1.6 a joint may have the name of a link; the name means the link")
def test_a_joint_may_have_the_name_of_a_link(tmp_path: Path) -> None:
    links = '<link name="a"/><link name="b"><pose>1 0 0 0 0 0</pose></link>'
    joint = '<joint name="b" type="prismatic"><parent>a</parent><child>b</child><pose>0 0 1 0 0 0</pose><axis><xyz>0 0 1</xyz></axis></joint>'
    got = body(tmp_path, f'{links}{joint}<frame name="f"><pose relative_to="b"/></frame>', "1.6")
    assert got.model.joint("b").child == "b"


# Files


@pytest.fixture
def fuel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str, int, str], None]:
    """Returns a function that writes a model of Fuel into Gazebo's cache: name, version, content."""
    monkeypatch.setenv("GZ_FUEL_CACHE_PATH", str(tmp_path / "cache"))

    def write(name: str, version: int, content: str) -> None:
        folder = tmp_path / "cache" / "fuel.gazebosim.org" / "openrobotics" / "models" / name / str(version)
        folder.mkdir(parents=True)
        (folder / "model.sdf").write_text(f'<sdf version="1.7"><model name="{name}">{content}</model></sdf>')

    return write


URL = "https://fuel.gazebosim.org/1.0/OpenRobotics/models/Chair"


@rule(
    FORMAT,
    "include/uri: https://fuel...",
    "done",
    "from Gazebo's cache, `$GZ_FUEL_CACHE_PATH` or `~/.gz/fuel`; the highest version, or that of the URL",
)
@pytest.mark.parametrize(("uri", "z"), [(URL, 10.0), (f"{URL}/2", 2.0), (f"{URL}/tip", 10.0), ("model://Chair", 10.0)])
def test_models_of_fuel_come_from_the_cache(tmp_path: Path, fuel: Callable[[str, int, str], None], uri: str, z: float) -> None:
    for version in (2, 10, 9):
        fuel("chair", version, f'<link name="l"><pose>0 0 {version} 0 0 0</pose>{VISUAL}</link>')
    scene = world(tmp_path, f"<include><uri>{uri}</uri></include>")
    assert places(scene) == [(0.0, 0.0, z)]


@rule(
    FORMAT,
    "include/uri: https://fuel...",
    "left out",
    "a model that is not in the cache; the warning names the command that downloads it",
)
def test_a_model_of_fuel_that_is_not_downloaded_is_named_with_the_command(tmp_path: Path) -> None:
    scene = world(tmp_path, f'<include><uri>{URL} B</uri></include><model name="m"><link name="l">{VISUAL}</link></model>')
    assert warned(scene.warnings, f"gz fuel download -u '{URL} B'")


@rule(FORMAT, "mesh/uri: https://fuel...", "done")
def test_a_mesh_of_fuel_comes_from_the_cache(tmp_path: Path, fuel: Callable[[str, int, str], None]) -> None:
    fuel("chair", 3, '<link name="l"/>')
    mesh = tmp_path / "cache" / "fuel.gazebosim.org" / "openrobotics" / "models" / "chair" / "3" / "meshes" / "a.obj"
    mesh.parent.mkdir()
    mesh.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    geometry = f"<geometry><mesh><uri>{URL}/tip/files/meshes/a.obj</uri></mesh></geometry>"
    scene = world(tmp_path, f'<model name="m"><link name="l"><visual name="v">{geometry}</visual></link></model>')
    assert [Path(v.shape.mesh).name for v in scene.visuals] == ["a.obj"]


@rule(
    FORMAT,
    "include/uri: model://",
    "done",
    "beside the world, in `$GZ_SIM_RESOURCE_PATH`, `$SDF_PATH`, `$GAZEBO_MODEL_PATH`, `$IGN_GAZEBO_RESOURCE_PATH`",
)
@pytest.mark.parametrize("variable", ["GZ_SIM_RESOURCE_PATH", "SDF_PATH", "GAZEBO_MODEL_PATH", "IGN_GAZEBO_RESOURCE_PATH"])
def test_models_come_from_the_folders_of_the_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, variable: str) -> None:
    model(tmp_path / "other", "chair", f'<link name="l">{VISUAL}</link>')
    monkeypatch.setenv(variable, f"/nowhere:{tmp_path / 'other' / 'scene' / 'models'}")
    assert len(world(tmp_path, "<include><uri>model://chair</uri></include>").visuals) == 1


@rule(FORMAT, "<model> at the top of a file", "done", "`--scene model.sdf` opens it on a ground plane")
def test_a_model_opens_as_a_scene_on_a_ground_plane(tmp_path: Path) -> None:
    model(tmp_path, "chair", f'<pose>1 0 0 0 0 0</pose><link name="l">{VISUAL}</link>')
    scene = load_scene(tmp_path / "scene" / "models" / "chair" / "model.sdf")
    assert (places(scene), scene.ground_z) == ([(1.0, 0.0, 0.0)], 0.0)
