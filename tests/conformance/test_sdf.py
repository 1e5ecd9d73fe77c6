"""SDF 1.4 to 1.12: each element is read as the specification says, or a warning names what is left out."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from conformance.rules import rule
from gibson_sim.description.body import BodySpec
from gibson_sim.errors import SceneError
from gibson_sim.formats.uris import UriResolver
from gibson_sim.geometry.transforms import Mat4, matrix_from_pose, pose_from_xyz_rpy
from gibson_sim.scenes.builder import SceneBuilder
from gibson_sim.scenes.load import load_scene
from gibson_sim.scenes.sdf.body import SdfBody, SdfBodyReader
from gibson_sim.scenes.sdf.elements import sdf_version
from gibson_sim.scenes.sdf.model import SdfModels
from gibson_sim.scenes.sdf.scopes import Scope
from gibson_sim.scenes.spawning import load_spawnable
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim.types import Pose

FORMAT = "SDF"
QUARTER = "1.5707963267948966"
BOX = "<geometry><box><size>1 2 3</size></box></geometry>"
COLLISION = f'<collision name="c">{BOX}</collision>'
DRAWN = f'<visual name="v">{BOX}</visual>'
VISUAL = DRAWN + COLLISION


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
    "pose",
    [
        "<pose>1 2</pose>", "<pose>1 2 3</pose>", "<pose>a b c d e f</pose>", "<pose>1_0 0 0 0 0 0</pose>", "<pose>1 2 3 0 0 0 1</pose>",
        '<pose rotation_format="quat_xyzw">1 2 3 0 0 0</pose>', '<pose rotation_format="rpy">1 2 3 0 0 0</pose>',
    ],
)  # fmt: skip
def test_a_pose_of_the_wrong_count_is_named(pose: str) -> None:
    found, warnings = scope(f'<link name="a">{pose}</link>')
    np.testing.assert_array_equal(found.pose("a"), np.eye(4))
    assert warned(warnings, "link a", "<pose>")


@rule(FORMAT, "pose[degrees]", "left out", "of a quaternion, which has no angles")
def test_degrees_of_a_quaternion_are_named() -> None:
    found, warnings = scope('<link name="a"><pose rotation_format="quat_xyzw" degrees="true">1 2 3 0 0 0 1</pose></link>')
    np.testing.assert_allclose(found.pose("a"), at(1, 2, 3))
    assert warned(warnings, "link a", "degrees", "quaternion")


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
def test_frame_attribute_of_older_versions_is_read_as_relative_to() -> None:
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
    assert not warned(scene.warnings, "frame")
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


@rule(FORMAT, "mesh/uri: https://fuel...", "left out", "a file that is not in the cache; one warning for all meshes of its model")
def test_meshes_of_a_model_that_is_not_downloaded_are_named_once(tmp_path: Path) -> None:
    visuals = "".join(
        f'<visual name="v{k}"><geometry><mesh><uri>{URL}/3/files/meshes/{k}.obj</uri></mesh></geometry></visual>'
        for k in range(3)
    )
    models = "".join(f'<model name="m{k}"><static>true</static><link name="l">{visuals}{VISUAL}</link></model>' for k in range(2))
    named = [line for line in world(tmp_path, models).warnings if "Chair" in line]
    assert len(named) == 1
    assert f"gz fuel download -u {URL}/3`; its meshes are left out" in named[0]


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


# Geometry


@rule(
    FORMAT, "<box>, <sphere>, <cylinder>, <capsule>, <ellipsoid>, <cone>", "done", "ellipsoids and cones collide as convex hulls"
)
@pytest.mark.parametrize(
    ("geometry", "kind", "size"),
    [
        ("<box><size>1 2 3</size></box>", "box", (1, 2, 3)),
        ("<sphere><radius>2</radius></sphere>", "sphere", (2, 0, 0)),
        ("<cylinder><radius>1</radius><length>2</length></cylinder>", "cylinder", (1, 2, 0)),
        ("<capsule><radius>1</radius><length>2</length></capsule>", "capsule", (1, 2, 0)),
        ("<ellipsoid><radii>1 2 3</radii></ellipsoid>", "ellipsoid", (1, 2, 3)),
        ("<cone><radius>1</radius><length>2</length></cone>", "cone", (1, 2, 0)),
    ],
)
def test_primitives_have_their_sizes(tmp_path: Path, geometry: str, kind: str, size: tuple[float, ...]) -> None:
    item = f"<geometry>{geometry}</geometry>"
    scene = world(
        tmp_path,
        f'<model name="m"><link name="l"><visual name="v">{item}</visual><collision name="c">{item}</collision></link></model>',
    )
    assert [(v.shape.kind, v.shape.size) for v in scene.visuals] == [(kind, size)]
    assert [(c.shape.kind, c.shape.size) for c in scene.collisions] == [(kind, size)]


@rule(FORMAT, "sizes of primitives", "refused", "missing, or not above 0: left out in a world, a body is refused")
@pytest.mark.parametrize("geometry", ["<box/>", "<sphere><radius>-1</radius></sphere>", "<capsule><radius>1</radius></capsule>"])
def test_invalid_sizes_are_named(tmp_path: Path, geometry: str) -> None:
    got = body(tmp_path, f'<link name="l"><collision name="c"><geometry>{geometry}</geometry></collision></link>').model
    assert warned(got.warnings, "link l", "must be finite and above 0")


@rule(FORMAT, "<plane>", "done", "a level collision plane is the infinite ground")
def test_a_level_plane_is_the_ground(tmp_path: Path) -> None:
    plane = '<collision name="c"><pose>0 0 0.5 0 0 0</pose><geometry><plane><normal>0 0 1</normal></plane></geometry></collision>'
    scene = world(tmp_path, f'<model name="g"><static>1</static><link name="l">{plane}</link></model>')
    assert (scene.ground_z, scene.collisions) == (0.5, ())


@rule(FORMAT, "<plane>", "approximated", "a plane that is not level, or of a body, collides as a plate of its <size>")
def test_a_vertical_plane_collides_as_a_plate(tmp_path: Path) -> None:
    plane = '<collision name="c"><geometry><plane><normal>1 0 0</normal><size>4 6</size></plane></geometry></collision>'
    scene = world(tmp_path, f'<model name="w"><static>1</static><link name="l">{plane}{DRAWN}</link></model>')
    (plate,) = scene.collisions
    assert plate.shape.size == (4.0, 6.0, 0.01)
    # The plate lies behind the plane x = 0.
    np.testing.assert_allclose(matrix_from_pose(plate.pose)[:3, 3], [-0.005, 0, 0], atol=1e-12)
    assert warned(scene.warnings, "model w", "4 x 6 m", "not as an infinite plane")


@rule(FORMAT, "<plane>", "refused", "in a body that moves")
def test_a_plane_that_moves_is_refused(tmp_path: Path) -> None:
    got = body(tmp_path, '<link name="l"><collision name="c"><geometry><plane/></geometry></collision></link>').model
    assert warned(got.warnings, "link l", "<static> model only")


@rule(FORMAT, "<heightmap>, <image>, <polyline>", "left out", "a world goes without them; a body is refused")
@pytest.mark.parametrize("geometry", ["heightmap", "image", "polyline"])
def test_geometry_without_a_counterpart_is_named(tmp_path: Path, geometry: str) -> None:
    link = f'<link name="l"><visual name="v"><geometry><{geometry}/></geometry></visual>{VISUAL}</link>'
    assert warned(
        world(tmp_path, f'<model name="m">{link}</model>').warnings, f"geometry <{geometry}> is not supported; left out"
    )


_CUBE = "1 3 4,1 4 2,5 6 8,5 8 7,1 2 6,1 6 5,3 7 8,3 8 4,1 5 7,1 7 3,2 4 8,2 8 6"
"""Triangles of a unit cube, wound outward."""


def _mesh(folder: Path, faces: str = _CUBE) -> None:
    path = folder / "scene" / "worlds" / "a.obj"
    path.parent.mkdir(parents=True, exist_ok=True)
    corners = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    path.write_text("".join(f"v {x} {y} {z}\n" for x, y, z in corners) + "".join(f"f {f}\n" for f in faces.split(",")))


@rule(FORMAT, "<mesh>", "done", "`uri`, `scale`")
@rule(FORMAT, "mesh/submesh", "approximated", "the whole mesh is used")
def test_meshes_are_scaled_and_whole(tmp_path: Path) -> None:
    _mesh(tmp_path)
    mesh = "<geometry><mesh><uri>a.obj</uri><scale>1 2 3</scale><submesh><name>s</name></submesh></mesh></geometry>"
    scene = world(tmp_path, f'<model name="m"><link name="l"><visual name="v">{mesh}</visual></link></model>')
    assert scene.visuals[0].shape.size == (1, 2, 3)
    assert warned(scene.warnings, "<submesh>", "the whole mesh is used")


# Materials


def _color(folder: Path, material: str, more: str = "") -> tuple[tuple[float, ...] | None, tuple[str, ...]]:
    visual = f'<visual name="v">{BOX}<material>{material}</material>{more}</visual>'
    scene = world(folder, f'<model name="m"><static>1</static><link name="l">{visual}{COLLISION}</link></model>')
    return scene.visuals[0].color, scene.warnings


@rule(FORMAT, "material/diffuse", "done", "also beside a <pbr>")
@pytest.mark.parametrize("more", ["", "<pbr><metal><roughness>0.2</roughness></metal></pbr>", "<pbr/>"])
def test_the_diffuse_colour_is_that_of_the_visual(tmp_path: Path, more: str) -> None:
    assert _color(tmp_path, f"<diffuse>1 0.5 0 1</diffuse>{more}") == ((1.0, 0.5, 0.0, 1.0), ())


@rule(FORMAT, "material/emissive", "approximated", "drawn as a colour that light falls on")
def test_a_material_with_emission_alone_has_its_colour(tmp_path: Path) -> None:
    color, warnings = _color(tmp_path, "<emissive>0 1 0 1</emissive>")
    assert color == (0.0, 1.0, 0.0, 1.0)
    assert warned(warnings, "<emissive>", "does not glow")


@rule(FORMAT, "material/pbr/metal/metalness, roughness", "done", "of worlds")
def test_metalness_and_roughness_are_drawn(tmp_path: Path) -> None:
    metal = "<pbr><metal><metalness>0.25</metalness><roughness>0.75</roughness></metal></pbr>"
    visual = f'<visual name="v">{BOX}<material><diffuse>1 0 0 1</diffuse>{metal}</material></visual>'
    (item,) = world(tmp_path, f'<model name="m"><link name="l">{visual}</link></model>').visuals
    assert item.appearance is not None
    assert (item.appearance.metallic, item.appearance.roughness) == (0.25, 0.75)


@rule(FORMAT, "material/pbr/metal/metalness, roughness", "left out", "of bodies")
def test_metalness_of_a_body_is_named(tmp_path: Path) -> None:
    material = "<material><pbr><metal><roughness>0.5</roughness></metal></pbr></material>"
    got = body(tmp_path, f'<link name="l"><visual name="v">{BOX}{material}</visual></link>').model
    assert warned(got.warnings, "metalness and roughness of a body")


@rule(FORMAT, "material/pbr: maps", "left out", "unless the mesh has textures of its own; the diffuse colour is drawn")
def test_textures_of_pbr_materials_are_named(tmp_path: Path) -> None:
    maps = "<pbr><metal><albedo_map>a.png</albedo_map><normal_map>n.png</normal_map></metal></pbr>"
    color, warnings = _color(tmp_path, f"<diffuse>1 0 0 1</diffuse>{maps}")
    assert color == (1.0, 0.0, 0.0, 1.0)
    assert warned(warnings, "texture a.png and 1 more of its <pbr> material are not drawn")


@rule(
    FORMAT,
    "material/script",
    "approximated",
    "Gazebo's plain colours; `.material` files of OGRE are not read, and named: convert them to `<pbr>`",
)
def test_scripts_of_gazebo_are_colours(tmp_path: Path) -> None:
    assert _color(tmp_path, "<script><name>Gazebo/Red</name></script>") == ((1.0, 0.0, 0.0, 1.0), ())
    assert warned(_color(tmp_path, "<script><name>My/Wood</name></script>")[1], "material script My/Wood is not read")


@rule(FORMAT, "visual/transparency", "done")
def test_transparency_is_opacity(tmp_path: Path) -> None:
    assert _color(tmp_path, "<diffuse>1 0 0 1</diffuse>", "<transparency>0.25</transparency>")[0] == (1.0, 0.0, 0.0, 0.75)


@rule(FORMAT, "visual/transparency", "approximated", "a mesh with its own colours stays opaque")
def test_transparency_of_a_mesh_is_named(tmp_path: Path) -> None:
    _mesh(tmp_path)
    visual = '<visual name="v"><geometry><mesh><uri>a.obj</uri></mesh></geometry><transparency>0.5</transparency></visual>'
    assert warned(world(tmp_path, f'<model name="m"><link name="l">{visual}</link></model>').warnings, "<transparency>", "opaque")


# Masses


def _inertial(
    folder: Path, content: str, attributes: str = "", shapes: str = ""
) -> tuple[float, np.ndarray, np.ndarray, tuple[str, ...]]:
    """Returns mass, centre (3,), inertia (ixx, ixy, ixz, iyy, iyz, izz), and the warnings."""
    got = body(folder, f'<link name="l"><inertial{attributes}>{content}</inertial>{shapes}</link>').model
    inertial = got.links[-1].inertial
    assert inertial is not None
    return inertial.mass, np.array(inertial.pose.position), np.array(inertial.inertia), got.warnings


def _solid(geometry: str, more: str = "") -> str:
    return f'<collision name="c">{more}<geometry>{geometry}</geometry></collision>'


@rule(FORMAT, "<inertial>", "done", "mass 1 kg and inertia 1 kg m^2 about each axis by default")
def test_masses_and_inertias_are_read(tmp_path: Path) -> None:
    inertia = "<inertia><ixx>2</ixx><ixy>0.1</ixy><ixz>0.2</ixz><iyy>3</iyy><iyz>0.3</iyz><izz>4</izz></inertia>"
    mass, center, moments, _ = _inertial(tmp_path, f"<pose>1 2 3 0 0 0</pose><mass>5</mass>{inertia}")
    assert (mass, center.tolist(), moments.tolist()) == (5.0, [1, 2, 3], [2, 0.1, 0.2, 3, 0.3, 4])
    mass, _, moments, _ = _inertial(tmp_path, "")
    assert (mass, moments.tolist()) == (1.0, [1, 0, 0, 1, 0, 1])


@rule(FORMAT, '<inertial auto="true">', "done", "box, sphere, cylinder, capsule, ellipsoid, cone and closed meshes")
@pytest.mark.parametrize(
    ("geometry", "volume", "moments", "z"),
    [
        ("<box><size>1 2 3</size></box>", 6.0, (13 / 12, 10 / 12, 5 / 12), 0.0),
        ("<sphere><radius>0.5</radius></sphere>", math.pi / 6, (0.1, 0.1, 0.1), 0.0),
        ("<cylinder><radius>1</radius><length>2</length></cylinder>", 2 * math.pi, (7 / 12, 7 / 12, 0.5), 0.0),
        ("<ellipsoid><radii>1 2 3</radii></ellipsoid>", 8 * math.pi, (13 / 5, 10 / 5, 5 / 5), 0.0),
        ("<cone><radius>1</radius><length>2</length></cone>", 2 * math.pi / 3, (0.3, 0.3, 0.3), -0.5),
        ("<mesh><uri>../../worlds/a.obj</uri></mesh>", 1.0, (1 / 6, 1 / 6, 1 / 6), 0.5),
    ],
)
def test_auto_inertia_is_that_of_the_solid(
    tmp_path: Path, geometry: str, volume: float, moments: tuple[float, ...], z: float
) -> None:
    _mesh(tmp_path)
    mass, center, got, warnings = _inertial(tmp_path, "<density>100</density>", ' auto="true"', _solid(geometry))
    assert mass == pytest.approx(100 * volume, rel=1e-9)
    assert center[2] == pytest.approx(z, abs=1e-9)
    np.testing.assert_allclose(got[[0, 3, 5]] / mass, moments, rtol=1e-9)
    assert not warnings


@rule(FORMAT, '<inertial auto="true">', "approximated", "a mesh that is not closed, or not wound consistently: its convex hull")
@pytest.mark.parametrize("faces", [_CUBE.removesuffix(",2 8 6"), _CUBE.replace("1 3 4", "1 4 3")], ids=["open", "mixed winding"])
def test_auto_inertia_of_an_open_or_badly_wound_mesh_is_that_of_its_hull(tmp_path: Path, faces: str) -> None:
    _mesh(tmp_path, faces)
    mesh = _solid("<mesh><uri>../../worlds/a.obj</uri></mesh>")
    mass, center, got, warnings = _inertial(tmp_path, "<density>2</density>", ' auto="true"', mesh)
    assert mass == pytest.approx(2.0)
    np.testing.assert_allclose(center, 0.5)
    np.testing.assert_allclose(got, [2 / 6, 0, 0, 2 / 6, 0, 2 / 6], atol=1e-9)
    assert warned(warnings, "link l", "a.obj is not closed or not wound consistently", "convex hull")


def test_auto_inertia_of_a_capsule_is_that_of_its_parts(tmp_path: Path) -> None:
    capsule = _solid("<capsule><radius>1</radius><length>2</length></capsule>")
    mass, _, got, _ = _inertial(tmp_path, "<density>1</density>", ' auto="true"', capsule)
    tube, ball = 2 * math.pi, 4 / 3 * math.pi
    # Half spheres: 83/320 r^2 about their centres of mass, which are 3/8 r beyond the ends of the tube.
    side = tube * (1 / 4 + 4 / 12) + ball * (83 / 320 + (1 + 3 / 8) ** 2)
    assert mass == pytest.approx(tube + ball, rel=1e-12)
    np.testing.assert_allclose(got[[0, 3, 5]], [side, side, tube / 2 + ball * 2 / 5], rtol=1e-9)


@rule(FORMAT, "collision/density", "done", "else that of the <inertial>, else 1000 kg/m^3, with a warning")
def test_density_of_a_collision_comes_first(tmp_path: Path) -> None:
    box = "<box><size>1 1 1</size></box>"
    shapes = _solid(box, "<pose>-1 0 0 0 0 0</pose><density>300</density>") + _solid(box, "<pose>1 0 0 0 0 0</pose>")
    mass, center, got, _ = _inertial(tmp_path, "<density>100</density>", ' auto="true"', shapes)
    assert (mass, center.tolist()) == (400.0, pytest.approx([-0.5, 0, 0]))
    # Parallel axes: 400 / 6, and 300 * 0.5^2 + 100 * 1.5^2.
    np.testing.assert_allclose(got[[0, 3, 5]], [400 / 6, 400 / 6 + 300, 400 / 6 + 300])
    assert warned(_inertial(tmp_path, "", ' auto="true"', _solid(box))[3], "1000 kg/m^3")


@rule(FORMAT, "inertial/mass with auto", "done", "SDF 1.12: the inertia is scaled to the mass")
def test_a_mass_scales_the_auto_inertia(tmp_path: Path) -> None:
    mass, _, got, warnings = _inertial(tmp_path, "<mass>6</mass>", ' auto="true"', _solid("<box><size>1 1 1</size></box>"))
    assert mass == 6.0
    np.testing.assert_allclose(got[[0, 3, 5]], 1.0)
    assert not warnings


@rule(FORMAT, "<auto_inertia_params>", "left out", "the volume of meshes is exact")
def test_parameters_of_auto_inertia_are_named(tmp_path: Path) -> None:
    content = "<density>1</density><auto_inertia_params><voxel_size>0.1</voxel_size></auto_inertia_params>"
    warnings = _inertial(tmp_path, content, ' auto="true"', _solid("<box><size>1 1 1</size></box>"))[3]
    assert warned(warnings, "<auto_inertia_params> of model m")


@rule(FORMAT, '<inertial auto="true">', "refused", "without a <collision> that encloses a volume")
def test_auto_inertia_without_a_volume_is_refused(tmp_path: Path) -> None:
    got = body(tmp_path, '<link name="l"><inertial auto="true"/></link>').model
    assert warned(got.warnings, "link l", "auto is true, but no <collision> encloses a volume")


# Joints

LINKS = '<link name="a"/><link name="b"><pose>1 0 0 0 0 0</pose></link><link name="c"><pose>2 0 0 0 0 0</pose></link>'


def _joint(name: str, kind: str, parent: str, child: str, inside: str = "") -> str:
    return f'<joint name="{name}" type="{kind}"><parent>{parent}</parent><child>{child}</child>{inside}</joint>'


@rule(FORMAT, "joint[type]", "done", "revolute, continuous, prismatic, fixed")
@pytest.mark.parametrize(
    ("kind", "got"), [("revolute", "continuous"), ("continuous", "continuous"), ("prismatic", "prismatic"), ("fixed", "fixed")]
)
def test_joints_have_their_types(tmp_path: Path, kind: str, got: str) -> None:
    content = LINKS + _joint("j", kind, "a", "b", "<axis><xyz>0 0 1</xyz></axis>") + _joint("k", "fixed", "b", "c")
    assert body(tmp_path, content).model.joint("j").kind == got


@rule(FORMAT, "joint[type]", "left out", "ball, universal, revolute2, screw, gearbox: fixed")
@pytest.mark.parametrize("kind", ["ball", "universal", "revolute2", "screw", "gearbox"])
def test_joints_that_are_not_simulated_are_fixed(tmp_path: Path, kind: str) -> None:
    got = body(tmp_path, LINKS + _joint("j", kind, "a", "b") + _joint("k", "fixed", "b", "c")).model
    assert got.joint("j").kind == "fixed"
    assert warned(got.warnings, f"'{kind}' is not simulated")


@rule(FORMAT, "axis/limit, axis/dynamics", "done", "limits, effort, velocity, damping, friction")
@rule(FORMAT, "axis/xyz[expressed_in]", "done")
def test_axes_have_limits_dynamics_and_a_frame(tmp_path: Path) -> None:
    limit = "<limit><lower>-1</lower><upper>2</upper><effort>3</effort><velocity>4</velocity></limit>"
    axis = f'<axis><xyz expressed_in="__model__">1 0 0</xyz>{limit}<dynamics><damping>5</damping><friction>6</friction></dynamics></axis>'
    turned = f'<link name="a"/><link name="b"><pose>1 0 0 0 0 {QUARTER}</pose></link>'
    got = body(tmp_path, turned + _joint("j", "revolute", "a", "b", axis)).model.joint("j")
    assert (got.lower, got.upper, got.effort, got.velocity, got.damping, got.friction) == (-1, 2, 3, 4, 5, 6)
    assert got.axis == pytest.approx((0, -1, 0))


@rule(FORMAT, "axis/mimic", "done", "multiplier, offset, reference; chains")
def test_an_axis_follows_its_leader(tmp_path: Path) -> None:
    axis = "<axis><xyz>0 0 1</xyz>{}</axis>"
    mimic = '<mimic joint="j"><multiplier>2</multiplier><offset>0.5</offset><reference>0.25</reference></mimic>'
    content = LINKS + _joint("j", "revolute", "a", "b", axis.format("")) + _joint("k", "revolute", "b", "c", axis.format(mimic))
    got = body(tmp_path, content).model.joint("k")
    assert got.mimic is not None
    # 2 (q - 0.25) + 0.5 = 2 q
    assert (got.mimic.leader, got.mimic.position(1.0)) == ("j", 2.0)


@rule(FORMAT, "axis/mimic", "refused", "a leader that does not exist, or a cycle")
def test_a_mimic_without_a_leader_is_named(tmp_path: Path) -> None:
    axis = '<axis><xyz>0 0 1</xyz><mimic joint="gone"><multiplier>2</multiplier></mimic></axis>'
    got = body(tmp_path, LINKS + _joint("j", "revolute", "a", "b", axis) + _joint("k", "fixed", "b", "c")).model
    assert warned(got.warnings, "'gone'", "not a movable joint")


@rule(FORMAT, "axis/dynamics/spring_stiffness, spring_reference", "left out", "nothing pulls the joint back")
def test_springs_are_named(tmp_path: Path) -> None:
    axis = "<axis><xyz>0 0 1</xyz><dynamics><spring_stiffness>3</spring_stiffness><spring_reference>1</spring_reference></dynamics></axis>"
    got = body(tmp_path, LINKS + _joint("j", "revolute", "a", "b", axis) + _joint("k", "fixed", "b", "c")).model
    assert warned(got.warnings, "joint j", "spring", "is not simulated")


# Surfaces


def _surface(folder: Path, surface: str) -> SceneSpec:
    collision = f'<collision name="c">{BOX}<surface>{surface}</surface></collision>'
    return world(folder, f'<model name="m"><static>1</static><link name="l">{collision}{DRAWN}</link></model>')


@rule(
    FORMAT,
    "surface/friction/ode/mu, bullet/friction",
    "done",
    "of worlds up to 1 (the coefficients of two surfaces are multiplied), of bodies all",
)
@pytest.mark.parametrize(("mu", "friction"), [("0.1", 0.1), ("100", 1.0)])
@pytest.mark.parametrize("engine", ["<ode><mu>{}</mu></ode>", "<bullet><friction>{}</friction></bullet>"])
def test_friction_of_a_world_is_read(tmp_path: Path, engine: str, mu: str, friction: float) -> None:
    scene = _surface(tmp_path, f"<friction>{engine.format(mu)}</friction>")
    assert [c.friction for c in scene.collisions] == [friction]
    assert not scene.warnings


def test_friction_of_the_ground_is_read(tmp_path: Path) -> None:
    surface = "<surface><friction><ode><mu>0.2</mu></ode></friction></surface>"
    plane = f'<collision name="c"><geometry><plane/></geometry>{surface}</collision>'
    assert world(tmp_path, f'<model name="g"><static>1</static><link name="l">{plane}</link></model>').ground_friction == 0.2


@rule(
    FORMAT,
    "surface: mu2, fdir1, slip, torsional, bounce, contact",
    "left out",
    "contacts are rigid, do not bounce, and have one friction coefficient",
)
@pytest.mark.parametrize(
    ("surface", "tag"),
    [
        ("<friction><ode><mu>1</mu><mu2>0.5</mu2></ode></friction>", "mu2"),
        ("<friction><ode><fdir1>1 0 0</fdir1></ode></friction>", "fdir1"),
        ("<friction><ode><slip1>0.1</slip1></ode></friction>", "slip1"),
        ("<friction><torsional><coefficient>1</coefficient></torsional></friction>", "torsional"),
        ("<friction><bullet><rolling_friction>0.1</rolling_friction></bullet></friction>", "rolling_friction"),
        ("<bounce><restitution_coefficient>0.5</restitution_coefficient></bounce>", "restitution_coefficient"),
        ("<contact><ode><kp>1e5</kp></ode></contact>", "kp"),
        ("<contact><collide_bitmask>0x01</collide_bitmask></contact>", "collide_bitmask"),
        ("<soft_contact><dart/></soft_contact>", "soft_contact"),
    ],
)
def test_properties_of_surfaces_without_a_counterpart_are_named(tmp_path: Path, surface: str, tag: str) -> None:
    assert warned(_surface(tmp_path, surface).warnings, f"<{tag}> of model m")


# Lights


@rule(
    FORMAT,
    "<light>",
    "done",
    "directional, point and spot; direction, diffuse, intensity, light_on, attenuation, angles; of the world and of links",
)
def test_lights_of_links_shine_and_have_an_intensity(tmp_path: Path) -> None:
    light = '<light name="lamp" type="point"><pose>0 0 1 0 0 0</pose><diffuse>1 1 1 1</diffuse><intensity>2</intensity></light>'
    off = '<light name="off" type="point"><diffuse>1 1 1 1</diffuse><light_on>false</light_on></light>'
    link = f'<link name="l"><pose>1 2 3 0 0 0</pose>{VISUAL}{light}{off}</link>'
    (lamp,) = world(tmp_path, f'<model name="m"><static>1</static>{link}</model>', lamps=True).light.points
    assert (lamp.position, lamp.strength) == ((1.0, 2.0, 4.0), 0.5)


@rule(
    FORMAT,
    "light: specular, cast_shadows, spot/falloff",
    "left out",
    "highlights and shadows are those of the renderer; spots fade linearly",
)
def test_parts_of_lights_without_a_counterpart_are_named(tmp_path: Path) -> None:
    light = (
        '<light name="sun" type="directional"><diffuse>1 1 1 1</diffuse><specular>0.5 0.5 0.5 1</specular><cast_shadows>1</cast_shadows>'
        '</light><light name="s" type="spot"><spot><falloff>0.8</falloff></spot></light>'
    )
    warnings = world(tmp_path, f'{light}<model name="m"><link name="l">{VISUAL}</link></model>').warnings
    assert warned(warnings, "<specular>", "<cast_shadows>")
    assert warned(warnings, "<falloff>")


@rule(FORMAT, "<light> of a body", "left out", "it does not shine")
def test_lights_of_bodies_are_named(tmp_path: Path) -> None:
    got = body(tmp_path, f'<link name="l">{VISUAL}<light name="led" type="point"/></link>').model
    assert warned(got.warnings, "light 'led' of a body does not shine")


@rule(FORMAT, "include of a <light>", "done")
def test_a_light_is_included_from_its_file(tmp_path: Path) -> None:
    folder = tmp_path / "scene" / "models" / "sun"
    folder.mkdir(parents=True)
    light = '<light name="sun" type="directional"><diffuse>1 0 0 1</diffuse><direction>0 0 -1</direction></light>'
    (folder / "model.sdf").write_text(f'<sdf version="1.7">{light}</sdf>')
    scene = world(tmp_path, f'<include><uri>model://sun</uri></include><model name="m"><link name="l">{VISUAL}</link></model>')
    assert (scene.light.sun_direction, scene.light.sun_color) == ((0, 0, -1), (1, 0, 0))


# What the simulator does not have

SIMPLE = f'<model name="m"><static>1</static><link name="l">{VISUAL}</link></model>'


@rule(FORMAT, "scene/ambient, scene/background, gravity", "done")
def test_ambient_background_and_gravity_are_read(tmp_path: Path) -> None:
    scene = world(
        tmp_path,
        f"<gravity>0 0 -1.6</gravity><scene><ambient>0.3 0.3 0.3 1</ambient><background>0 0 1 1</background></scene>{SIMPLE}",
    )
    assert (scene.gravity, scene.light.background) == ((0, 0, -1.6), (0, 0, 1))
    assert scene.light.ambient == pytest.approx(0.3)
    assert not scene.warnings


@rule(FORMAT, "<model> of a world", "approximated", "fixed, as if <static>; spawn what should move")
def test_models_of_a_world_that_move_are_named(tmp_path: Path) -> None:
    scene = world(tmp_path, f'{SIMPLE}<model name="ball"><link name="l">{VISUAL}</link></model>')
    assert scene.warnings == ("ball: not <static>, but fixed, as all models of a world; spawn what should move",)


@rule(
    FORMAT,
    "world: physics, plugin, gui, audio, wind, atmosphere, magnetic_field, spherical_coordinates, state, joint",
    "left out",
    "the simulator has its own, or none",
)
@rule(FORMAT, "scene: sky, fog, shadows, grid, origin_visual", "left out", "the background has one colour")
@pytest.mark.parametrize(
    "content",
    [
        '<physics type="ode"><max_step_size>0.001</max_step_size></physics>', '<plugin name="p" filename="f"/>', "<gui/>",
        '<audio><device>d</device></audio>', "<wind/>", '<atmosphere type="adiabatic"/>', "<magnetic_field>0 0 1</magnetic_field>",
        "<spherical_coordinates/>", '<state world_name="w"/>', _joint("j", "fixed", "world", "m"), "<scene><sky/></scene>",
        "<scene><fog/></scene>", "<scene><shadows>1</shadows></scene>", "<scene><grid>1</grid></scene>",
        "<scene><origin_visual>1</origin_visual></scene>",
    ],
)  # fmt: skip
def test_elements_of_worlds_without_a_counterpart_are_named(tmp_path: Path, content: str) -> None:
    element = ElementTree.fromstring(content)
    tag = element[0].tag if element.tag == "scene" else element.tag
    assert warned(world(tmp_path, content + SIMPLE).warnings, f"<{tag}>", "left out")


@rule(FORMAT, "<actor>, <population>, <road>", "left out", "walking people are part of trials")
@pytest.mark.parametrize("tag", ["actor", "population", "road"])
def test_actors_populations_and_roads_are_named(tmp_path: Path, tag: str) -> None:
    assert warned(world(tmp_path, f'<{tag} name="x"/>{SIMPLE}').warnings, f"<{tag}> 'x' is not supported; left out")


@rule(
    FORMAT,
    "link: sensor, projector, particle_emitter, audio_sink, audio_source, battery, velocity_decay, gravity, kinematic, enable_wind, self_collide",
    "left out",
    "robots have sensors; the rest is not simulated",
)
@rule(FORMAT, "model: plugin, gripper, self_collide, enable_wind, allow_auto_disable", "left out", "plugins are not run")
@pytest.mark.parametrize(
    "content",
    [
        '<sensor name="s" type="camera"/>', '<projector name="p"/>', '<particle_emitter name="e" type="box"/>', "<audio_sink/>",
        "<audio_source><uri>a</uri></audio_source>", '<battery name="b"/>', "<velocity_decay><linear>0.1</linear></velocity_decay>",
        "<gravity>0</gravity>", "<kinematic>1</kinematic>", "<enable_wind>1</enable_wind>", "<self_collide>1</self_collide>",
    ],
)  # fmt: skip
def test_elements_of_links_without_a_counterpart_are_named(tmp_path: Path, content: str) -> None:
    element = ElementTree.fromstring(content)
    tag = element[0].tag if element.tag == "velocity_decay" else element.tag
    got = body(tmp_path, f'<link name="l">{VISUAL}{content}</link>').model
    assert warned(got.warnings, f"<{tag}>", "left out")
    if tag in ("self_collide", "enable_wind"):
        assert warned(body(tmp_path, f'{content}<link name="l">{VISUAL}</link>').model.warnings, f"<{tag}>", "left out")


@pytest.mark.parametrize(
    "content", ['<plugin name="p" filename="f"/>', '<gripper name="g"/>', "<allow_auto_disable>0</allow_auto_disable>"]
)
def test_elements_of_models_without_a_counterpart_are_named(tmp_path: Path, content: str) -> None:
    tag = ElementTree.fromstring(content).tag
    assert warned(body(tmp_path, f'{content}<link name="l">{VISUAL}</link>').model.warnings, f"<{tag}>", "left out")


@rule(FORMAT, "visual: cast_shadows, laser_retro, visibility_flags, meta, plugin", "left out", "cameras see all visuals")
@rule(FORMAT, "collision: laser_retro, max_contacts", "left out", "lidars return no intensity of single objects")
@pytest.mark.parametrize(
    "content",
    [
        "<cast_shadows>0</cast_shadows>", "<laser_retro>5</laser_retro>", "<visibility_flags>1</visibility_flags>",
        "<meta><layer>2</layer></meta>", '<plugin name="p" filename="f"/>',
    ],
)  # fmt: skip
def test_elements_of_visuals_without_a_counterpart_are_named(tmp_path: Path, content: str) -> None:
    element = ElementTree.fromstring(content)
    tag = element[0].tag if element.tag == "meta" else element.tag
    got = body(tmp_path, f'<link name="l"><visual name="v">{BOX}{content}</visual></link>').model
    assert warned(got.warnings, f"<{tag}>", "left out")


@rule(
    FORMAT,
    "material: specular, shininess, shader, lighting, render_order, double_sided",
    "left out",
    "highlights follow metalness and roughness",
)
@pytest.mark.parametrize("content", ["<specular>1 1 1 1</specular>", "<lighting>0</lighting>", "<double_sided>1</double_sided>"])
def test_parts_of_materials_without_a_counterpart_are_named(tmp_path: Path, content: str) -> None:
    assert warned(_color(tmp_path, content)[1], f"<{ElementTree.fromstring(content).tag}>", "left out")


@rule(
    FORMAT,
    "unknown elements",
    "left out",
    "those that SDF does not have are named; elements with a prefix, such as `<gz:type>`, are extensions of others",
)
def test_elements_that_sdf_does_not_have_are_named(tmp_path: Path) -> None:
    got = body(tmp_path, f'<link name="l">{VISUAL}<colour>red</colour></link>').model
    assert warned(got.warnings, "<colour> in <link>: unknown in SDF")


@rule(FORMAT, "elements with a prefix", "done", "extensions of others, skipped; the prefix need not be declared")
def test_prefixes_need_not_be_declared(tmp_path: Path) -> None:
    scene = world(
        tmp_path,
        f'<!-- <a:b/> --><model name="m"><static>1</static><link name="l" my:tag="1">{VISUAL}<my:mass>1</my:mass></link></model>',
    )
    assert len(scene.visuals) == 1
    assert scene.warnings == ()


@rule(
    FORMAT, "frame[attached_to], model[canonical_link]", "refused", "names that lead to no link, even if nothing depends on them"
)
@pytest.mark.parametrize(
    ("content", "attributes", "words"),
    [
        ('<frame name="f" attached_to="gone"/>', "", "'gone'"),
        ('<frame name="f" attached_to="g"/><frame name="g" attached_to="f"/>', "", "leads to no link"),
        ("", ' canonical_link="gone"', "canonical link 'gone' does not exist"),
        ("", ' canonical_link="__model__"', "canonical link '__model__' does not exist"),
        ('<frame name="f"/>', ' canonical_link="f"', "leads to no link"),
        ('<frame name="f"><pose relative_to="gone"/></frame>', "", "'gone'"),
    ],
)
def test_frames_without_effect_are_named(tmp_path: Path, content: str, attributes: str, words: str) -> None:
    got = body(tmp_path, f'<link name="l">{VISUAL}</link>{content}', attributes=attributes).model
    assert warned(got.warnings, words)


@rule(FORMAT, "numbers of worlds and lights", "refused", "values that are no finite numbers are named, and the default is used")
@pytest.mark.parametrize(
    "content",
    [
        "<gravity>0 0 down</gravity>", "<scene><ambient>bright</ambient></scene>", "<scene><background>1 2</background></scene>",
        '<light name="x" type="point"><diffuse>1 1 1 1</diffuse><attenuation><range>nan</range></attenuation></light>',
        '<light name="x" type="directional"><diffuse>1 1 1 1</diffuse><direction>0 0</direction></light>',
    ],
)  # fmt: skip
def test_invalid_numbers_are_named(tmp_path: Path, content: str) -> None:
    assert warned(world(tmp_path, content + SIMPLE).warnings, "must be", "the default is used")


@rule(FORMAT, "names of joints", "refused", "two joints of one model with the same name")
def test_two_joints_of_one_name_are_named(tmp_path: Path) -> None:
    got = body(tmp_path, LINKS + _joint("j", "fixed", "a", "b") + _joint("j", "fixed", "b", "c")).model
    assert warned(got.warnings, "two joints are named 'j'")


# Further parts of models


@rule(FORMAT, "model/static", "done", "of a body: nothing of it moves")
@rule(FORMAT, "include/static", "done")
def test_static_models_are_fixed(tmp_path: Path) -> None:
    assert body(tmp_path, f"<static>true</static>{LINKS}").static
    assert not body(tmp_path, LINKS).static
    model(tmp_path, "n", f'<link name="l">{VISUAL}</link>')
    include = "<include><uri>model://n</uri>{}</include>"
    assert warned(world(tmp_path, include.format("")).warnings, "not <static>")
    assert not world(tmp_path, include.format("<static>1</static>")).warnings


@rule(FORMAT, "model/static", "approximated", "a static model within a body that moves: it moves with that one")
def test_a_static_model_within_one_that_moves_is_named(tmp_path: Path) -> None:
    inner = '<model name="n"><static>1</static><link name="l"/></model>'
    assert warned(body(tmp_path, f'<link name="a"/>{inner}').model.warnings, "m::n", "moves with that one")


@rule(FORMAT, "joint/parent: world", "done", "a fixed joint to the world makes a body static")
def test_a_body_is_fixed_to_the_world(tmp_path: Path) -> None:
    got = body(
        tmp_path, LINKS + _joint("w", "fixed", "world", "a") + _joint("j", "fixed", "a", "b") + _joint("k", "fixed", "b", "c")
    )
    assert got.static


@rule(FORMAT, "joint: loops", "left out", "a joint that gives a link a second parent")
def test_joints_that_close_loops_are_named(tmp_path: Path) -> None:
    loop = _joint("j", "fixed", "a", "b") + _joint("k", "fixed", "b", "c") + _joint("back", "revolute", "a", "c")
    assert warned(body(tmp_path, LINKS + loop).model.warnings, "'back'", "second parent or closes a loop; left out")


@rule(FORMAT, "links without a joint", "approximated", "fixed to the first link of the body")
def test_links_without_a_joint_are_named(tmp_path: Path) -> None:
    assert warned(body(tmp_path, LINKS).model.warnings, "no joint connects b, c; fixed to a")


@rule(FORMAT, "axis/use_parent_model_frame", "done", "SDF 1.5 and 1.6; in 1.4 all axes are in the frame of the model")
@pytest.mark.parametrize(
    ("version", "content", "axis"),
    [("1.4", "", (0, -1, 0)), ("1.6", "", (1, 0, 0)), ("1.6", "<use_parent_model_frame>1</use_parent_model_frame>", (0, -1, 0))],
)
def test_axes_of_older_versions(tmp_path: Path, version: str, content: str, axis: tuple[float, ...]) -> None:
    turned = f'<link name="a"/><link name="b"><pose>1 0 0 0 0 {QUARTER}</pose></link>'
    joint = _joint("j", "prismatic", "a", "b", f"<axis><xyz>1 0 0</xyz>{content}</axis>")
    assert body(tmp_path, turned + joint, version).model.joint("j").axis == pytest.approx(axis)


@rule(
    FORMAT,
    "joint: sensor, physics/ode, physics/simbody, limit/stiffness, axis/initial_position",
    "left out",
    "stops are rigid, and joints start at 0",
)
@pytest.mark.parametrize(
    ("axis", "joint", "tag"),
    [
        ("<initial_position>0.5</initial_position>", "", "initial_position"),
        ("<limit><stiffness>10</stiffness></limit>", "", "stiffness"),
        ("<limit><dissipation>10</dissipation></limit>", "", "dissipation"),
        ("", "<physics><ode><cfm_damping>1</cfm_damping></ode></physics>", "ode"),
        ("", "<physics><simbody/></physics>", "simbody"),
        ("", '<sensor name="s" type="force_torque"/>', "sensor"),
    ],
)
def test_parts_of_joints_without_a_counterpart_are_named(tmp_path: Path, axis: str, joint: str, tag: str) -> None:
    content = _joint("j", "revolute", "a", "b", f"<axis><xyz>0 0 1</xyz>{axis}</axis>{joint}") + _joint("k", "fixed", "b", "c")
    assert warned(body(tmp_path, LINKS + content).model.warnings, f"<{tag}>", "left out")


@rule(FORMAT, "inertial/fluid_added_mass", "left out", "there is no fluid")
def test_added_mass_is_named(tmp_path: Path) -> None:
    content = "<mass>1</mass><fluid_added_mass><xx>1</xx></fluid_added_mass>"
    assert warned(_inertial(tmp_path, content)[3], "<fluid_added_mass>", "there is no fluid")


@pytest.mark.parametrize("content", ["<laser_retro>5</laser_retro>", "<max_contacts>1</max_contacts>"])
def test_elements_of_collisions_without_a_counterpart_are_named(tmp_path: Path, content: str) -> None:
    got = body(tmp_path, f'<link name="l"><collision name="c">{BOX}{content}</collision></link>').model
    assert warned(got.warnings, f"<{ElementTree.fromstring(content).tag}>", "left out")


@rule(
    FORMAT,
    "mesh[optimization], mesh/convex_decomposition",
    "left out",
    "fixed meshes collide with all triangles, others as convex hulls",
)
def test_the_optimization_of_meshes_is_named(tmp_path: Path) -> None:
    _mesh(tmp_path)
    mesh = '<geometry><mesh optimization="convex_decomposition"><uri>a.obj</uri></mesh></geometry>'
    scene = world(tmp_path, f'<model name="m"><link name="l">{VISUAL}<collision name="c">{mesh}</collision></link></model>')
    assert warned(scene.warnings, "'convex_decomposition'", "has no effect")


@rule(FORMAT, "a model without collisions", "approximated", "it collides as it is drawn")
def test_a_model_without_collisions_collides_as_it_is_drawn(tmp_path: Path) -> None:
    content = f'<model name="m"><static>1</static><link name="l"><visual name="v">{BOX}</visual></link></model>'
    scene = world(tmp_path, content)
    assert [c.shape for c in scene.collisions] == [v.shape for v in scene.visuals]
    assert scene.warnings == ("m: without a <collision>: collides as it is drawn",)
    assert warned(body(tmp_path, f'<link name="l"><visual name="v">{BOX}</visual></link>').model.warnings, "as it is drawn")


@rule(FORMAT, "model.config", "done", "the newest of its <sdf> versions")
def test_the_newest_version_of_a_model_is_included(tmp_path: Path) -> None:
    model(tmp_path, "n", '<link name="old"/>')
    folder = tmp_path / "scene" / "models" / "n"
    (folder / "new.sdf").write_text(f'<sdf version="1.10"><model name="n"><link name="l">{VISUAL}</link></model></sdf>')
    listed = '<sdf version="1.9">model.sdf</sdf><sdf version="1.10">new.sdf</sdf>'
    (folder / "model.config").write_text(f"<model><name>n</name>{listed}</model>")
    assert len(world(tmp_path, "<include><uri>model://n</uri></include>").visuals) == 1


@rule(FORMAT, "include/uri: file://, package://, relative", "done")
@pytest.mark.parametrize("uri", ["../models/n", "../models/n/model.sdf", "file://{}/scene/models/n"])
def test_models_are_included_by_path(tmp_path: Path, uri: str) -> None:
    model(tmp_path, "n", f'<link name="l">{VISUAL}</link>')
    assert len(world(tmp_path, f"<include><uri>{uri.format(tmp_path)}</uri></include>").visuals) == 1


@rule(FORMAT, "several <world>", "approximated", "the first")
def test_first_of_several_worlds_is_read(tmp_path: Path) -> None:
    (tmp_path / "w.sdf").write_text(f'<sdf version="1.9"><world name="a">{SIMPLE}</world><world name="b"/></sdf>')
    assert warned(load_scene(tmp_path / "w.sdf").warnings, "several worlds; the first, 'a', is used")


@rule(FORMAT, "<include> without a file", "left out", "the rest of the world is read; a body is refused")
def test_missing_models_are_named(tmp_path: Path) -> None:
    scene = world(tmp_path, f"<include><uri>model://gone</uri></include>{SIMPLE}")
    assert warned(scene.warnings, "model://gone does not exist; left out")


@rule(FORMAT, "<sdf> without a world or a model", "refused")
@pytest.mark.parametrize("text", ["<sdf/>", '<sdf version="1.9"><light name="l" type="point"/></sdf>', "<sdf"])
def test_files_without_a_world_are_refused_in_one_line(tmp_path: Path, text: str) -> None:
    (tmp_path / "w.sdf").write_text(text)
    with pytest.raises(SceneError) as caught:
        load_scene(tmp_path / "w.sdf")
    assert "w.sdf" in str(caught.value)
    assert "\n" not in str(caught.value)


@rule(FORMAT, "spawned models: https://fuel...", "done", "from Gazebo's cache")
def test_models_of_fuel_are_spawned_by_their_url(fuel: Callable[[str, int, str], None]) -> None:
    fuel("chair", 3, f'<link name="l"><inertial><mass>2</mass></inertial>{VISUAL}</link>')
    thing = load_spawnable(URL, "", name="c", pose=Pose())
    assert isinstance(thing, BodySpec)
    assert thing.links == ("l",)
    with pytest.raises(SceneError, match="gz fuel download -u"):
        load_spawnable(f"{URL}2", "", name="c", pose=Pose())


@rule(FORMAT, "light[type], light/diffuse", "done", "point and white by default")
def test_a_light_is_white_and_a_point_by_default(tmp_path: Path) -> None:
    (lamp,) = world(tmp_path, f'<light name="x"><pose>1 2 3 0 0 0</pose></light>{SIMPLE}', lamps=True).light.points
    assert (lamp.position, lamp.color, lamp.strength) == ((1, 2, 3), (1.0, 1.0, 1.0), 0.25)


@rule(FORMAT, "pose[relative_to]", "refused", "a chain of many hundreds of frames, the last first")
def test_a_chain_of_frames_that_is_too_long_is_refused_in_one_line() -> None:
    frames = "".join(f'<frame name="f{k}"><pose relative_to="f{k + 1}">1 0 0 0 0 0</pose></frame>' for k in range(2000))
    with pytest.raises(SceneError, match="model m: a chain of frames"):
        scope(f'<link name="l"/>{frames}<frame name="f2000"/>')
    found, warnings = scope(
        '<link name="l"/><frame name="f200"/>'
        + "".join(f'<frame name="f{k}"><pose relative_to="f{k + 1}">1 0 0 0 0 0</pose></frame>' for k in range(199, -1, -1))
    )
    np.testing.assert_allclose(found.pose("f0"), at(200, 0, 0))
    assert not warnings


@rule(FORMAT, "<geometry> with several shapes", "approximated", "the first")
def test_first_of_several_shapes_is_used(tmp_path: Path) -> None:
    shapes = "<geometry><box><size>1 2 3</size></box><sphere><radius>1</radius></sphere></geometry>"
    got = body(tmp_path, f'<link name="l"><collision name="c">{shapes}</collision></link>').model
    assert [c.shape.kind for c in got.links[-1].collisions] == ["box"]
    assert warned(got.warnings, "link l", "'c'", "<box>, <sphere>", "the first is used")


@rule(FORMAT, "<collision>, <visual> without <geometry>", "refused", "left out in a world, a body is refused")
@pytest.mark.parametrize("tag", ["collision", "visual"])
def test_shapes_without_a_geometry_are_named(tmp_path: Path, tag: str) -> None:
    got = body(tmp_path, f'<link name="l"><{tag} name="c"/>{VISUAL}</link>').model
    assert warned(got.warnings, "link l", f"<{tag}> 'c' has no <geometry>")


@rule(FORMAT, "elements that count once", "approximated", "<pose>, <geometry>, <inertial>, ...: the first")
def test_first_of_repeated_unique_elements_is_used(tmp_path: Path) -> None:
    poses = "<pose>1 0 0 0 0 0</pose><pose>2 0 0 0 0 0</pose>"
    scene = world(tmp_path, f'<model name="m"><static>1</static>{poses}<link name="l">{VISUAL}</link></model>')
    assert places(scene) == [(1, 0, 0)]
    assert warned(scene.warnings, "2 <pose> in model m: only the first of several counts")
    got = body(tmp_path, f'<link name="l"><inertial/><inertial/>{VISUAL}</link>').model
    assert warned(got.warnings, "2 <inertial> in link l (model m)", "only the first")


@rule(
    FORMAT, "names of siblings", "approximated", "models, links, collisions or visuals of the same name: named, and all are read"
)
def test_siblings_of_the_same_name_are_named(tmp_path: Path) -> None:
    one = f'<model name="m"><static>1</static><link name="l">{VISUAL}</link></model>'
    scene = world(tmp_path, one + one)
    assert len(scene.visuals) == 2
    assert warned(scene.warnings, "world w", "'m' is used by two <model>")
    scene = world(tmp_path, one.replace("</model>", f'<link name="l">{VISUAL}</link></model>'))
    assert warned(scene.warnings, "model m", "'l' is used by two <link>")
    scene = world(tmp_path, one.replace(VISUAL, VISUAL + COLLISION))
    assert warned(scene.warnings, "2 <collision> c in link l (model m): names must be unique")
    assert not world(tmp_path, one).warnings


@rule(FORMAT, "include/plugin", "left out", "plugins are not run")
def test_plugins_of_includes_are_named(tmp_path: Path) -> None:
    model(tmp_path, "box", f'<static>1</static><link name="l">{VISUAL}</link>')
    scene = world(tmp_path, '<include><uri>model://box</uri><plugin name="p" filename="f"/></include>')
    assert warned(scene.warnings, "<plugin> of p (world w)", "plugins are not run")


@rule(FORMAT, "colours", "approximated", "values outside of 0 to 1 are clipped")
def test_colours_outside_of_their_range_are_named(tmp_path: Path) -> None:
    color, warnings = _color(tmp_path, "<diffuse>255 0 0 1</diffuse>")
    assert color == (1, 0, 0, 1)
    assert warned(warnings, "model m", "<diffuse> is '255 0 0 1', must be 0 to 1")
    still = f'<model name="m"><static>1</static><link name="l">{VISUAL}</link></model>'
    scene = world(tmp_path, f"<scene><background>9 0 0</background></scene>{still}")
    assert warned(scene.warnings, "<background>", "must be 0 to 1")


@rule(FORMAT, "inertial/pose, inertial/inertia with auto", "left out", "the shapes decide")
def test_values_beside_auto_inertia_are_named(tmp_path: Path) -> None:
    content = "<density>1</density><pose>1 0 0 0 0 0</pose><inertia><ixx>9</ixx></inertia>"
    mass, center, _, warnings = _inertial(tmp_path, content, ' auto="true"', _solid("<box><size>1 1 1</size></box>"))
    assert (mass, center.tolist()) == (1.0, [0, 0, 0])
    assert warned(warnings, "link l: inertial: auto is true; <inertia> and <pose> beside it has no effect")


@rule(FORMAT, "sdf[version]", "approximated", "above 1.12: read as 1.12")
def test_a_later_version_is_named(tmp_path: Path) -> None:
    still = f'<model name="m"><static>1</static><link name="l">{VISUAL}</link></model>'
    assert not world(tmp_path, still, "1.12").warnings
    assert warned(world(tmp_path, still, "1.13").warnings, "is SDF 1.13, and is read as 1.12")
    model(tmp_path, "box", f'<static>1</static><link name="l">{VISUAL}</link>', "2.0")
    assert warned(world(tmp_path, "<include><uri>model://box</uri></include>", "1.12").warnings, "model.sdf: is SDF 2.0")


@rule(FORMAT, "unknown attributes", "left out", "each is named")
def test_attributes_that_sdf_does_not_have_are_named(tmp_path: Path) -> None:
    content = f'<pose relativeto="l" gz:note="1">1 0 0 0 0 0</pose><link name="l" mass="2">{VISUAL}</link>'
    scene = world(tmp_path, f'<model name="m"><static>1</static>{content}</model>')
    (line,) = scene.warnings
    assert line == "relativeto of <pose>, mass of <link>: attributes that SDF does not have; they have no effect"
