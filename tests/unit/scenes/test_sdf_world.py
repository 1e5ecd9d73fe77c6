"""SDF worlds: includes, poses, search of models, and warnings about everything left out."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.errors import SceneError
from gibson_sim.geometry.transforms import matrix_from_pose
from gibson_sim.scenes.load import load_scene
from gibson_sim.scenes.spec import SceneSpec

HALF_TURN = "1.5707963267948966"
BOX = "<geometry><box><size>1 2 3</size></box></geometry>"


def _model(folder: Path, name: str, content: str) -> None:
    (folder / "models" / name).mkdir(parents=True)
    (folder / "models" / name / "model.sdf").write_text(f'<sdf version="1.6"><model name="{name}">{content}</model></sdf>')


def _load(folder: Path, content: str, *, sdf_lamps: bool = False) -> SceneSpec:
    path = folder / "worlds" / "w.world"
    path.parent.mkdir(parents=True, exist_ok=True)
    (folder / "models").mkdir(exist_ok=True)
    path.write_text(f'<sdf version="1.6"><world name="w">{content}</world></sdf>')
    return load_scene(path, sdf_lamps=sdf_lamps)


def _others(scene: SceneSpec) -> tuple[str, ...]:
    """Returns the warnings except those that models of the world are fixed, and collide as they are drawn."""
    return tuple(w for w in scene.warnings if "not <static>, but fixed" not in w and "collides as it is drawn" not in w)


def _box_link(pose: str = "") -> str:
    return f'<link name="l">{pose}<visual name="v">{BOX}</visual><collision name="c">{BOX}</collision></link>'


def test_nested_includes_compose_their_poses(tmp_path: Path) -> None:
    _model(tmp_path, "inner", _box_link("<pose>1 0 0 0 0 0</pose>"))
    _model(tmp_path, "outer", f"<include><uri>model://inner</uri><pose>2 0 0 0 0 {HALF_TURN}</pose></include>")
    scene = _load(tmp_path, f"<include><uri>model://outer</uri><name>o</name><pose>10 20 0 0 0 {HALF_TURN}</pose></include>")
    (visual,) = scene.visuals
    # In inner (1, 0); rotated and moved in outer (2, 1); rotated again (-1, 2) and moved: (9, 22), facing backwards.
    np.testing.assert_allclose(
        matrix_from_pose(visual.pose), [[-1, 0, 0, 9], [0, -1, 0, 22], [0, 0, 1, 0], [0, 0, 0, 1]], atol=1e-9
    )
    assert visual.name == "o"
    assert visual.shape.size == (1, 2, 3)
    assert scene.collisions[0].pose == visual.pose


def test_model_of_the_world_uses_its_own_pose_and_that_of_the_visual(tmp_path: Path) -> None:
    scene = _load(
        tmp_path,
        f'<model name="m"><pose>0 0 5 0 0 {HALF_TURN}</pose><link name="l"><pose>1 0 0 0 0 0</pose>'
        f'<visual name="v"><pose>0 1 0 0 0 0</pose>{BOX}</visual></link></model>',
    )
    # (1, 1) in the model, rotated by 90 degrees: (-1, 1).
    np.testing.assert_allclose(matrix_from_pose(scene.visuals[0].pose)[:3, 3], [-1, 1, 5], atol=1e-9)


def test_pose_relative_to_another_link(tmp_path: Path) -> None:
    scene = _load(
        tmp_path,
        f'<model name="m"><link name="a"><pose>1 0 0 0 0 {HALF_TURN}</pose></link><link name="b">'
        f'<pose relative_to="a">2 0 0 0 0 0</pose><visual name="v">{BOX}</visual></link></model>',
    )
    np.testing.assert_allclose(matrix_from_pose(scene.visuals[0].pose)[:3, 3], [1, 2, 0], atol=1e-9)


def test_folder_of_the_environment_holds_models_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _model(tmp_path / "elsewhere", "chair", _box_link())
    world = "<include><uri>model://chair</uri></include>"
    monkeypatch.setenv("GAZEBO_MODEL_PATH", str(tmp_path / "elsewhere" / "models"))
    assert [v.name for v in _load(tmp_path / "scene", world).visuals] == ["chair"]


def test_missing_model_is_a_warning_that_names_it(tmp_path: Path) -> None:
    scene = _load(tmp_path, f'<include><uri>model://Portrait_A</uri></include><model name="m">{_box_link()}</model>')
    assert [v.name for v in scene.visuals] == ["m"]
    (warning,) = _others(scene)
    assert "model://Portrait_A" in warning


def test_missing_mesh_is_a_warning_that_names_model_and_mesh(tmp_path: Path) -> None:
    mesh = "<geometry><mesh><uri>model://m/gone.dae</uri></mesh></geometry>"
    scene = _load(tmp_path, f'<model name="m">{_box_link()}<link name="k"><visual name="v">{mesh}</visual></link></model>')
    assert len(scene.visuals) == 1
    assert any("m" in w and "gone.dae" in w for w in scene.warnings)


def test_plane_collision_is_the_ground(tmp_path: Path) -> None:
    plane = "<geometry><plane><normal>0 0 1</normal><size>10 10</size></plane></geometry>"
    scene = _load(
        tmp_path,
        f'<model name="g"><pose>0 0 0.25 0 0 0</pose><link name="l"><collision name="c">{plane}</collision></link></model>',
    )
    assert scene.ground_z == pytest.approx(0.25)
    assert scene.floor_z == pytest.approx(0.25)
    assert scene.collisions == ()


def test_ground_plane_of_gazebo_needs_no_file(tmp_path: Path) -> None:
    scene = _load(tmp_path, "<include><uri>model://ground_plane</uri></include><include><uri>model://sun</uri></include>")
    assert scene.ground_z == 0.0
    assert scene.warnings == ()


def test_drawn_model_without_collision_collides_as_it_is_drawn(tmp_path: Path) -> None:
    scene = _load(tmp_path, f'<model name="m"><link name="l"><visual name="v">{BOX}</visual></link></model>')
    assert [c.shape for c in scene.collisions] == [scene.visuals[0].shape]


def test_absurd_pose_is_left_out_with_a_warning(tmp_path: Path) -> None:
    scene = _load(
        tmp_path, f'<model name="far"><pose>0 0 343582 0 0 0</pose>{_box_link()}</model><model name="near">{_box_link()}</model>'
    )
    assert [v.name for v in scene.visuals] == ["near"]
    assert [c.name for c in scene.collisions] == ["near"]
    (warning,) = _others(scene)
    assert "far" in warning
    assert "343582" in warning


@pytest.mark.parametrize("pose", ["1 2 x 0 0 0", "1 2", "nan 0 0 0 0 0"])
def test_unreadable_pose_is_zero_with_a_warning(tmp_path: Path, pose: str) -> None:
    scene = _load(tmp_path, f'<model name="m"><pose>{pose}</pose>{_box_link()}</model>')
    assert tuple(scene.visuals[0].pose.position) == (0, 0, 0)
    assert any(pose in w for w in scene.warnings)


def test_model_that_includes_itself_is_left_out_there_with_a_warning(tmp_path: Path) -> None:
    # Included twice: without a limit of depth, the number would double with each level.
    _model(tmp_path, "loop", _box_link() + "<include><uri>model://loop</uri></include>" * 2)
    scene = _load(tmp_path, "<include><uri>model://loop</uri></include>")
    assert [v.name for v in scene.visuals] == ["loop"]
    (warning,) = _others(scene)
    assert "loop" in warning
    assert "includes itself" in warning


def test_models_that_include_each_other_are_left_out_there(tmp_path: Path) -> None:
    _model(tmp_path, "a", _box_link() + "<include><uri>model://b</uri></include>")
    _model(tmp_path, "b", _box_link() + "<include><uri>model://a</uri></include>")
    scene = _load(tmp_path, "<include><uri>model://a</uri></include>")
    assert [v.name for v in scene.visuals] == ["a", "a_2"]
    assert any("includes itself" in warning for warning in scene.warnings)


def test_model_may_be_included_many_times(tmp_path: Path) -> None:
    _model(tmp_path, "leg", _box_link())
    legs, tables = (
        "".join(f"<include><uri>model://{model}</uri><name>{model}_{k}</name></include>" for k in range(count))
        for model, count in (("leg", 4), ("table", 2))
    )
    _model(tmp_path, "table", legs)
    scene = _load(tmp_path, tables)
    assert len(scene.visuals) == 8
    assert _others(scene) == ()


SUN = '<light name="sun" type="directional"><diffuse>0.5 0.25 0.25 1</diffuse><direction>0 1 -1</direction></light>'
LAMP = (
    '<light name="lamp" type="point"><pose>1 0 2 0 0 0</pose><diffuse>1 0.5 0.5 1</diffuse><attenuation><range>7</range>'
    "<constant>0.5</constant><linear>0.1</linear><quadratic>0.2</quadratic></attenuation></light>"
)


def test_the_sun_and_the_background_are_read(tmp_path: Path) -> None:
    background = "<scene><background>0.1 0.2 0.3 1</background></scene>"
    light = _load(tmp_path, f'{LAMP}{SUN}{background}<model name="m">{_box_link()}</model>').light
    assert light.sun_direction == (0, 1, -1)
    # 0.7 of the mean of 0.5, 0.25, 0.25; the colour has its brightest channel at 1.
    assert light.sun == pytest.approx(0.7 / 3.0)
    assert light.sun_color == (1.0, 0.5, 0.5)
    assert light.background == (0.1, 0.2, 0.3)
    # Lamps count as ambient light, unless they are requested.
    assert (light.points, light.ambient) == ((), 0.5)


def test_lamps_are_read_on_request(tmp_path: Path) -> None:
    light = _load(tmp_path, f'{LAMP}<model name="m">{_box_link()}</model>', sdf_lamps=True).light
    (lamp,) = light.points
    assert light.sun == 0.0
    assert (lamp.position, lamp.color, lamp.range, lamp.attenuation) == ((1, 0, 2), (1.0, 0.5, 0.5), 7, (0.5, 0.1, 0.2))
    # A quarter of the mean.
    assert lamp.strength == pytest.approx(0.25 * 2.0 / 3.0)
    assert lamp.outer_angle == math.pi


def test_a_spot_points_along_its_direction_in_its_own_pose(tmp_path: Path) -> None:
    spot = (
        f'<light name="s" type="spot"><pose>0 0 2 {HALF_TURN} 0 0</pose><diffuse>1 1 1 1</diffuse><direction>0 0 -1</direction>'
        "<spot><inner_angle>0.4</inner_angle><outer_angle>1.0</outer_angle></spot></light>"
    )
    (lamp,) = _load(tmp_path, f'{spot}<model name="m">{_box_link()}</model>', sdf_lamps=True).light.points
    # A quarter turn about x takes -z to y; the angles are full ones.
    np.testing.assert_allclose(lamp.direction, (0, 1, 0), atol=1e-9)
    assert (lamp.inner_angle, lamp.outer_angle) == pytest.approx((0.2, 0.5))


@pytest.mark.parametrize("light", ["<light/>", '<light type="spot"><diffuse>bright</diffuse></light>'])
def test_odd_light_does_no_harm(tmp_path: Path, light: str) -> None:
    assert len(_load(tmp_path, f'{light}<model name="m">{_box_link()}</model>').visuals) == 1


def test_lamp_in_a_static_model_does_no_harm(tmp_path: Path) -> None:
    lamp = '<light name="bulb" type="point"><diffuse>1 1 1 1</diffuse></light>'
    link = _box_link().replace("</link>", f"{lamp}</link>")
    scene = _load(tmp_path, f'<model name="m"><static>true</static>{link}{lamp}</model>')
    assert [v.name for v in scene.visuals] == ["m"]
    assert scene.warnings == ("<light> in <model>: unknown in SDF; left out",)


def test_diffuse_colour_and_transparency_are_read(tmp_path: Path) -> None:
    look = "<transparency>0.25</transparency><material><diffuse>1 0 0 1</diffuse></material>"
    scene = _load(tmp_path, f'<model name="m"><link name="l"><visual name="v">{BOX}{look}</visual></link></model>')
    assert scene.visuals[0].color == (1, 0, 0, 0.75)


def test_class_is_made_of_the_name_of_the_model(tmp_path: Path) -> None:
    _model(tmp_path, "aws_robomaker_residential_KitchenTable_01", _box_link())
    scene = _load(tmp_path, "<include><uri>model://aws_robomaker_residential_KitchenTable_01</uri><name>t</name></include>")
    assert scene.visuals[0].semantic_class == "kitchen_table"


@pytest.mark.parametrize("text", ["<sdf", "<sdf version='1.6'/>", "<robot/>"])
def test_file_without_a_world_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "w.world").write_text(text)
    with pytest.raises(SceneError, match=r"w\.world"):
        load_scene(tmp_path / "w.world")


@pytest.mark.parametrize(
    ("material", "said"),
    [
        (
            "<script><uri>model://m/materials/scripts</uri><name>Shelf/Diffuse</name></script>",
            "material script Shelf/Diffuse is not read",
        ),
        (
            "<pbr><metal><albedo_map>textures/shelf.png</albedo_map></metal></pbr>",
            "texture textures/shelf.png of its <pbr> material",
        ),
        ("<script><name>Gazebo/FlatBlack</name></script>", ""),
        ("<script><name>Shelf/Diffuse</name></script><diffuse>1 0 0 1</diffuse>", ""),
    ],
)
def test_a_material_that_is_not_read_is_named(tmp_path: Path, material: str, said: str) -> None:
    visual = f'<visual name="v">{BOX}<material>{material}</material></visual>'
    scene = _load(tmp_path, f'<model name="m"><link name="l">{visual}</link></model>')
    assert len(_others(scene)) == bool(said)
    assert all(f"model m: {said}" in w for w in _others(scene))
