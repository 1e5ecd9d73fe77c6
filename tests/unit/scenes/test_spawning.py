"""Resources that can be spawned, and the errors for those that cannot."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from gibson_sim.description.body import BodySpec
from gibson_sim.errors import SceneNotFoundError
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.scenes import spawning
from gibson_sim.scenes.builder import class_from_model
from gibson_sim.scenes.spawning import (
    MAX_PARTS,
    SPAWN_FORMATS,
    SpawnError,
    SpawnFailure,
    find_spawnables,
    load_spawnable,
    spawn_name,
)
from gibson_sim.types import Pose
from support.effort import effort
from support.gltf import Gltf
from support.scenes import write_square_obj

BOX = "<collision><geometry><box size='1 1 1'/></geometry></collision>"
AT = Pose((1.0, 2.0, 3.0))
CODES = SpawnFailure


def _urdf(inside: str = BOX, more: str = "") -> str:
    return f"<robot name='crate'><link name='base'>{inside}</link>{more}</robot>"


def _sdf(inside: str = "", name: str = "lamp") -> str:
    box = "<collision name='c'><geometry><box><size>1 1 1</size></box></geometry></collision>"
    return f"<sdf version='1.7'><model name='{name}'><link name='base'>{box}{inside}</link></model></sdf>"


def _load(uri: str = "", text: str = "", roots: tuple[Path, ...] = ()) -> BodySpec | RobotSpec:
    return load_spawnable(uri, text, name="thing", pose=AT, roots=roots)


def _body(uri: str = "", text: str = "", roots: tuple[Path, ...] = ()) -> BodySpec:
    body = _load(uri, text, roots)
    assert isinstance(body, BodySpec)
    return body


def _error(uri: str = "", text: str = "", roots: tuple[Path, ...] = ()) -> SpawnError:
    with pytest.raises(SpawnError) as caught:
        _load(uri, text, roots)
    message = str(caught.value)
    assert message
    assert "\n" not in message
    assert "nonexistent" not in message
    return caught.value


def _write(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


# Formats


def test_urdf_file_becomes_a_body_of_that_name_and_pose(tmp_path: Path) -> None:
    body = _body(str(_write(tmp_path / "crate.urdf", _urdf())))
    assert (body.name, body.start, body.static, body.semantic_class) == ("thing", AT, False, "crate")
    assert body.links == ("base",)


@pytest.mark.parametrize("text", [_urdf(), "\n  <?xml version='1.0'?>\n" + _urdf(), _sdf()])
def test_text_is_read_as_what_its_outermost_element_says(text: str) -> None:
    assert _body(text=text).links == ("base",)


def test_uri_wins_over_text(tmp_path: Path) -> None:
    path = _write(tmp_path / "crate.urdf", _urdf())
    assert _body(str(path), _sdf()).model.name == "crate"


@pytest.mark.parametrize("write", ["model.sdf", "model-1_7.sdf"])
def test_model_folder_is_read_by_its_config_file(tmp_path: Path, write: str) -> None:
    _write(tmp_path / "lamp" / write, _sdf())
    _write(tmp_path / "lamp" / "model.config", f"<model><sdf version='1.7'>{write}</sdf></model>")
    assert _body(str(tmp_path / "lamp")).model.name == "lamp"
    assert _body(str(tmp_path / "lamp" / "model.config")).model.name == "lamp"


def test_folder_with_one_urdf_is_read_as_that_urdf(tmp_path: Path) -> None:
    _write(tmp_path / "crate" / "any.urdf", _urdf())
    assert _body(str(tmp_path / "crate")).model.name == "crate"


def test_folder_with_several_things_lists_them(tmp_path: Path) -> None:
    for name in ("a", "b"):
        _write(tmp_path / f"{name}.urdf", _urdf())
    error = _error(str(tmp_path))
    assert error.code is CODES.UNSUPPORTED_FORMAT
    assert "a.urdf, b.urdf" in str(error)


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
def test_mesh_becomes_one_rigid_link(tmp_path: Path, suffix: str) -> None:
    gltf = Gltf()
    gltf.triangle([[0, 0, 0], [1, 0, 0], [0, 0, 1], [0, 3, 0]], [0, 1, 2, 0, 1, 3, 1, 2, 3, 0, 2, 3])
    body = _body(str(gltf.write(tmp_path / f"Tip_01{suffix}")))
    assert (len(body.links), body.static, body.semantic_class) == (1, False, "tip")
    assert body.model.links[0].inertial is not None


def test_details_of_a_mesh_that_are_left_out_refuse_no_spawn(tmp_path: Path) -> None:
    _write(tmp_path / "tip.mtl", "newmtl m\nKd 1 0 0\nmap_bump gone.png\n")
    _write(
        tmp_path / "tip.obj",
        "mtllib tip.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nl 1 2\nusemtl m\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n",
    )
    geometry = "<geometry><mesh><uri>tip.obj</uri></mesh></geometry>"
    link = f"<link name='l'><visual name='v'>{geometry}</visual><collision name='c'>{geometry}</collision></link>"
    body = _body(str(_write(tmp_path / "tip.sdf", f"<sdf version='1.7'><model name='m'>{link}</model></sdf>")))
    assert any("map_bump is left out" in line for line in body.model.warnings)


def test_thing_of_too_many_triangles_is_refused_with_what_to_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _write(tmp_path / "square.obj", "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 1\nf 1 2 3\nf 1 3 4\n")
    geometry = "<geometry><mesh><uri>square.obj</uri></mesh></geometry>"
    link = f"<link name='l'><visual name='v'>{geometry}</visual><collision name='c'>{geometry}</collision></link>"
    moves, static = (
        str(_write(tmp_path / f"{kind}.sdf", f"<sdf version='1.7'><model name='m'><static>{kind}</static>{link}</model></sdf>"))
        for kind in ("false", "true")
    )
    monkeypatch.setattr(spawning, "MAX_STATIC_TRIANGLES", 1)
    assert _body(moves).static is False, "its hull alone is touched"
    error = _error(static)
    assert error.code is CODES.UNSUPPORTED_ASSETS
    assert "has 2 triangles in its collision shapes, at most 1 may be spawned while a simulation runs; simplify" in error.public
    monkeypatch.setattr(spawning, "MAX_TRIANGLES", 1)
    assert "has 2 triangles in its visuals, at most 1" in _error(moves).public


def test_built_in_robot_is_spawned_by_name_with_cameras_and_drive() -> None:
    robot = _load("gibson_bot")
    assert isinstance(robot, RobotSpec)
    assert (robot.name, robot.start) == ("thing", AT)
    assert robot.drive is not None


def test_built_in_object_is_spawned_by_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _write(tmp_path / "objects" / "lamp" / "model.sdf", _sdf())
    monkeypatch.setenv("GIBSON_SIM_PATH", str(tmp_path))
    assert _body("lamp", roots=(tmp_path / "elsewhere",)).model.name == "lamp"
    assert "lamp" in [spawnable.uri for spawnable in find_spawnables(())]


@pytest.mark.parametrize("scheme", ["file", "package", "model", "path"])
def test_uris_of_every_scheme_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, scheme: str) -> None:
    path = _write(tmp_path / "share" / "my crates" / "crate.urdf", _urdf())
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    uri = {
        "file": path.as_uri(),
        "package": "package://my%20crates/crate.urdf",
        "model": "model://my%20crates/crate.urdf",
        "path": str(path),
    }[scheme]
    assert _body(uri).model.name == "crate"


def test_models_of_gazebo_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _write(tmp_path / "lamp" / "model.sdf", _sdf())
    monkeypatch.setenv("GZ_SIM_RESOURCE_PATH", str(tmp_path))
    assert _body("model://lamp").model.name == "lamp"


def test_urdf_with_a_link_called_world_is_fixed_to_it() -> None:
    joint = "<joint name='j' type='fixed'><parent link='world'/><child link='base'/></joint>"
    assert _body(text=_urdf(more="<link name='world'/>" + joint)).static


def test_static_model_is_static() -> None:
    assert _body(text=_sdf().replace("<link", "<static>1</static><link")).static


# Names


def test_names_are_those_in_the_file(tmp_path: Path) -> None:
    assert spawn_name("", _urdf()) == "crate"
    assert spawn_name("", _sdf()) == "lamp"
    assert spawn_name(str(_write(tmp_path / "x.urdf", _urdf())), "") == "crate"
    assert spawn_name("gibson_bot", "") == "gibson_bot"


@pytest.mark.parametrize("uri", ["/nowhere/x.urdf", "", "http://x/y.sdf", "/dev/zero", "\0"])
def test_unreadable_descriptions_have_no_name(uri: str) -> None:
    assert spawn_name(uri, "") == ""


# Missing and unreadable files


@pytest.mark.parametrize(
    "uri",
    [
        "/nowhere/x.urdf", "no_such_thing", "file:///nowhere.obj", "file://relative.obj", "package://nobody/x.urdf", "model://nobody",
        "https://example.org/x.sdf", "x\0.urdf", "file:///x%00.urdf", "/" + "x" * 5000, "/tmp/" + "x" * 300 + ".urdf", "/\udcff\ud800.obj",
        "~nobody_of_that_name/x.urdf",
    ],
)  # fmt: skip
def test_missing_resource_is_no_resource(uri: str) -> None:
    assert _error(uri).code is CODES.NO_RESOURCE


def test_empty_uri_and_text_are_no_resource() -> None:
    assert _error(" ", "\n").code is CODES.NO_RESOURCE


def test_unknown_name_lists_ours() -> None:
    assert "gibson_bot" in str(_error("gibson_bott"))


@pytest.mark.parametrize("uri", ["/etc/passwd", "/dev/zero", "/", "/proc/self/mem"])
def test_other_files_are_an_unsupported_format(uri: str) -> None:
    error = _error(uri)
    assert error.code is CODES.UNSUPPORTED_FORMAT
    assert "URDF" in str(error)


@pytest.mark.parametrize("name", ["pipe.obj", "pipe.urdf", "zero.stl"])
def test_pipes_and_devices_are_not_opened(tmp_path: Path, name: str) -> None:
    if name.startswith("pipe"):
        os.mkfifo(tmp_path / name)
    else:
        (tmp_path / name).symlink_to("/dev/zero")
    error = _error(str(tmp_path / name))
    assert error.code is CODES.UNSUPPORTED_FORMAT
    assert "not a regular file" in str(error)


@pytest.mark.parametrize(("name", "megabytes"), [("big.glb", 513), ("big.urdf", 33)])
def test_huge_files_are_not_read(tmp_path: Path, name: str, megabytes: int) -> None:
    with (tmp_path / name).open("wb") as file:
        file.truncate(megabytes * 1024 * 1024)
    error = _error(str(tmp_path / name))
    assert error.code is CODES.UNSUPPORTED_FORMAT
    assert f"{megabytes} MB" in str(error)


def test_files_outside_the_roots_are_refused_however_they_are_named(tmp_path: Path) -> None:
    inside, outside = tmp_path / "in", _write(tmp_path / "out" / "crate.urdf", _urdf())
    inside.mkdir()
    (inside / "link.urdf").symlink_to(outside)
    (inside / "folder").symlink_to(outside.parent)
    for uri in (
        outside,
        inside / "link.urdf",
        inside / "folder" / "crate.urdf",
        inside / ".." / "out" / "crate.urdf",
        "/etc/passwd",
    ):
        error = _error(str(uri), roots=(inside,))
        assert error.code is CODES.NO_RESOURCE, uri
        assert str(inside) in str(error)
    assert _error(outside.as_uri(), roots=(inside,)).code is CODES.NO_RESOURCE
    assert _body(str(outside), roots=(inside, outside.parent)).model.name == "crate"


def test_roots_do_not_tell_whether_a_file_outside_exists(tmp_path: Path) -> None:
    assert "lies outside" in str(_error("/etc/no_such_file", roots=(tmp_path,)))


def test_meshes_outside_the_roots_are_refused(tmp_path: Path) -> None:
    mesh = write_square_obj(tmp_path / "out", "t.png")
    (tmp_path / "out" / "t.png").write_bytes(b"x")
    visual = f"<visual><geometry><mesh filename='{mesh}'/></geometry></visual>"
    path = _write(tmp_path / "in" / "crate.urdf", _urdf(visual))
    error = _error(str(path), roots=(tmp_path / "in",))
    assert error.code is CODES.UNSUPPORTED_ASSETS
    assert "square.obj" in str(error)
    assert _body(str(path), roots=(tmp_path,)).links == ("base",)


@pytest.mark.parametrize("include", ["../out/model.sdf", "file://{folder}/out/model.sdf", "model://out"])
def test_models_outside_the_roots_are_refused(tmp_path: Path, include: str) -> None:
    _write(tmp_path / "out" / "model.sdf", _sdf())
    uri = include.format(folder=tmp_path)
    path = _write(tmp_path / "in" / "model.sdf", _sdf().replace("<link", f"<include><uri>{uri}</uri></include><link"))
    assert _error(str(path), roots=(tmp_path / "in",)).code is CODES.UNSUPPORTED_ASSETS
    assert len(_body(str(path), roots=(tmp_path,)).links) == 2


def test_robot_yaml_must_not_name_a_urdf_outside(tmp_path: Path) -> None:
    _write(tmp_path / "out.urdf", _urdf())
    path = _write(tmp_path / "in" / "robot.yaml", "urdf: ../out.urdf\n")
    assert _error(str(path), roots=(tmp_path / "in",)).code is CODES.NO_RESOURCE


def test_robot_is_measured_by_its_meshes_unless_they_lie_outside(tmp_path: Path) -> None:
    # The square spans y from -0.5 to 0.5 m and z from 0 to 1 m.
    _write(tmp_path / "meshes" / "square.obj", "v 0 -0.5 0\nv 0 0.5 0\nv 0 0.5 1\nv 0 -0.5 1\nf 1 2 3 4\n")
    mesh = "<collision><geometry><mesh filename='../meshes/square.obj'/></geometry></collision>"
    _write(tmp_path / "robot" / "robot.urdf", _urdf(mesh))
    path = _write(tmp_path / "robot" / "robot.yaml", "urdf: robot.urdf\n")
    robot = _load(str(path), roots=(tmp_path,))
    assert isinstance(robot, RobotSpec)
    assert (robot.radius, robot.height) == pytest.approx((0.5, 1.0))
    assert "give radius and height" in str(_error(str(path), roots=(tmp_path / "robot",)))


# Broken and hostile descriptions


@pytest.mark.parametrize("text", ["hello", "{}", "<html/>", "<world/>", "<sdf><world name='w'/></sdf>", "urdf"])
def test_text_of_another_kind_is_an_unsupported_format(text: str) -> None:
    assert _error(text=text).code is CODES.UNSUPPORTED_FORMAT


def test_xacro_is_refused_with_advice(tmp_path: Path) -> None:
    xacro = "<robot xmlns:xacro='http://www.ros.org/wiki/xacro'><xacro:include filename='x'/></robot>"
    for error in (
        _error(text=xacro), _error(str(_write(tmp_path / "a.urdf", xacro))), _error(str(_write(tmp_path / "a.urdf.xacro", "x"))),
        _error(text="<robot><xacro:arg name='x'/></robot>"),
    ):  # fmt: skip
        assert error.code is CODES.UNSUPPORTED_FORMAT
        assert "expand it first: xacro" in str(error)


def test_xacro_in_a_comment_is_ignored() -> None:
    assert _body(text=_urdf().replace("<link", "<!-- <xacro:include/> --><link")).links == ("base",)


BOMB = "<!DOCTYPE r [<!ENTITY a 'aaaaaaaaaa'>" + "".join(
    f"<!ENTITY {chr(98 + k)} '{('&' + chr(97 + k) + ';') * 10}'>" for k in range(12)
)


@pytest.mark.parametrize(
    "text",
    [
        "<robot", "<robot name='x'/>", _urdf().replace("base", ""), f"{BOMB}]><robot name='&m;'/>", "<robot>" * 100_000,
        "<!DOCTYPE r [<!ENTITY x SYSTEM 'file:///etc/passwd'>]><robot name='&x;'><link name='l'/></robot>",
        _urdf(more="<link name='other'/>"), _urdf("<inertial/>"), _sdf().replace("<link", "<nothing"),
    ],
)  # fmt: skip
def test_broken_descriptions_are_parse_errors(text: str) -> None:
    assert _error(text=text).code is CODES.RESOURCE_PARSE_ERROR


def _inertial(mass: str = "1", ixx: str = "1", xyz: str = "0 0 0") -> str:
    inertia = f"<inertia ixx='{ixx}' ixy='0' ixz='0' iyy='1' iyz='0' izz='1'/>"
    return f"<inertial><origin xyz='{xyz}'/><mass value='{mass}'/>{inertia}</inertial>"


@pytest.mark.parametrize(
    ("inside", "value"),
    [
        (_inertial(mass="2e6"), "2e+06"),
        (_inertial(mass="-1"), "-1"),
        (_inertial(mass="nan"), "nan"),
        (_inertial(ixx="1e10"), "1e+10"),
        (_inertial(ixx="-1"), "-1"),
        (_inertial(ixx="inf"), "inf"),
        (_inertial(xyz="0 0 1e5"), "100000"),
        (BOX.replace("1 1 1", "1 1 20000"), "20000"),
        (BOX.replace("1 1 1", "1 0 1"), "0.0"),
        (BOX.replace("<geometry>", "<origin xyz='0 -1e9 0'/><geometry>"), "-1e+09"),
        ("<contact><lateral_friction value='-1'/></contact>", "-1"),
    ],
)
def test_implausible_numbers_are_named(inside: str, value: str) -> None:
    error = _error(text=_urdf(inside))
    assert error.code is CODES.RESOURCE_PARSE_ERROR
    assert "'base'" in str(error)
    assert value in str(error)


@pytest.mark.parametrize("value", ["nan", "-1"])
def test_impossible_mass_of_an_sdf_is_named(value: str) -> None:
    error = _error(text=_sdf(f"<inertial><mass>{value}</mass></inertial>"))
    assert error.code is CODES.RESOURCE_PARSE_ERROR
    assert "base" in str(error)
    assert value in str(error)


def test_mesh_that_is_larger_than_the_world_is_refused(tmp_path: Path) -> None:
    path = _write(tmp_path / "big.obj", "v 0 0 0\nv 1e6 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\n")
    error = _error(str(path))
    assert error.code is CODES.RESOURCE_PARSE_ERROR
    assert "1e+06" in str(error)


@pytest.mark.parametrize("scale", ["0 1 1", "1e6 1 1"])
def test_absurd_scale_of_a_mesh_is_refused(tmp_path: Path, scale: str) -> None:
    write_square_obj(tmp_path, "t.png")
    (tmp_path / "t.png").write_bytes(b"x")
    visual = f"<visual><geometry><mesh filename='square.obj' scale='{scale.replace('1 1', '1e6 1')}'/></geometry></visual>"
    assert _error(str(_write(tmp_path / "a.urdf", _urdf(visual)))).code is CODES.RESOURCE_PARSE_ERROR


@pytest.mark.parametrize("kind", ["floating", "planar"])
def test_joint_that_is_not_simulated_is_refused(kind: str) -> None:
    joint = f"<link name='b'/><joint name='j' type='{kind}'><parent link='base'/><child link='b'/></joint>"
    error = _error(text=_urdf(more=joint))
    assert error.code is CODES.RESOURCE_PARSE_ERROR
    assert kind in str(error)


def test_model_of_more_than_500_links_is_refused() -> None:
    more = "".join(
        f"<link name='l{k}'/><joint name='j{k}' type='fixed'><parent link='base'/><child link='l{k}'/></joint>"
        for k in range(500)
    )
    error = _error(text=_urdf(more=more))
    assert error.code is CODES.RESOURCE_PARSE_ERROR
    assert "501 links" in str(error)


def test_model_of_more_joints_than_can_move_is_refused() -> None:
    links = "".join(f"<link name='l{i}'/>" for i in range(201))
    ends = "".join(
        f"<joint name='j{i}' type='revolute'><parent link='l{i}'/><child link='l{i + 1}'/></joint>" for i in range(200)
    )
    error = _error(text=f"<robot name='snake'>{links}{ends}</robot>")
    assert error.code is CODES.RESOURCE_PARSE_ERROR
    assert "has 200 moving joints" in str(error)
    assert "at most 121 moving joints" in str(error)


def test_model_that_includes_itself_twice_is_an_error_soon(tmp_path: Path) -> None:
    include = "<include><uri>model://loop</uri></include>" * 2
    path = _write(tmp_path / "loop" / "model.sdf", _sdf().replace("<link", include + "<link"))
    error = _error(str(path))
    assert error.code is CODES.RESOURCE_PARSE_ERROR
    assert "includes itself" in str(error)


def test_two_models_that_include_each_other_are_an_error(tmp_path: Path) -> None:
    for name, other in (("a", "b"), ("b", "a")):
        include = f"<include><uri>model://{other}</uri></include>"
        _write(tmp_path / name / "model.sdf", _sdf(name=name).replace("<link", include + "<link"))
    assert _error(str(tmp_path / "a")).code is CODES.RESOURCE_PARSE_ERROR


# Assets


def test_every_missing_mesh_is_named(tmp_path: Path) -> None:
    visuals = "".join(f"<visual><geometry><mesh filename='{n}.obj'/></geometry></visual>" for n in ("one", "two"))
    error = _error(str(_write(tmp_path / "a.urdf", _urdf(visuals))))
    assert error.code is CODES.MISSING_ASSETS
    assert "one.obj" in str(error)
    assert "two.obj" in str(error)
    assert "left out" not in str(error)


def test_every_missing_mesh_of_an_sdf_is_named(tmp_path: Path) -> None:
    visuals = "".join(
        f"<visual name='{n}'><geometry><mesh><uri>model://lamp/{n}.obj</uri></mesh></geometry></visual>" for n in ("one", "two")
    )
    error = _error(str(_write(tmp_path / "lamp" / "model.sdf", _sdf(visuals))))
    assert error.code is CODES.MISSING_ASSETS
    assert "one.obj" in str(error)
    assert "two.obj" in str(error)


def test_missing_included_model_is_named(tmp_path: Path) -> None:
    path = _write(tmp_path / "model.sdf", _sdf().replace("<link", "<include><uri>model://gone</uri></include><link"))
    error = _error(str(path))
    assert error.code is CODES.MISSING_ASSETS
    assert "model://gone" in str(error)


def test_missing_texture_is_named(tmp_path: Path) -> None:
    error = _error(str(write_square_obj(tmp_path, "gone.png")))
    assert error.code is CODES.MISSING_ASSETS
    assert "gone.png" in str(error)


def test_missing_urdf_of_a_robot_is_a_missing_asset(tmp_path: Path) -> None:
    error = _error(str(_write(tmp_path / "robot.yaml", "urdf: gone.urdf\n")))
    assert error.code is CODES.MISSING_ASSETS
    assert "gone.urdf" in str(error)


def test_relative_mesh_of_a_text_is_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # No file lies beside a string, not even those of the current folder.
    write_square_obj(tmp_path, "t.png")
    monkeypatch.chdir(tmp_path)
    visual = "<visual><geometry><mesh filename='square.obj'/></geometry></visual>"
    assert _error(text=_urdf(visual)).code is CODES.MISSING_ASSETS


@pytest.mark.parametrize(
    ("name", "content"),
    [("a.wrl", b"#VRML"), ("a.obj", b"v 1 x\n"), ("a.stl", b""), ("a.glb", b"glTF\x02\0\0\0\xff\xff\xff\xff")],
)
def test_mesh_that_cannot_be_read_is_an_unsupported_asset(tmp_path: Path, name: str, content: bytes) -> None:
    (tmp_path / name).write_bytes(content)
    visual = f"<visual><geometry><mesh filename='{name}'/></geometry></visual>"
    error = _error(str(_write(tmp_path / "m.urdf", _urdf(visual))))
    assert error.code is CODES.UNSUPPORTED_ASSETS
    assert name in str(error)


@pytest.mark.parametrize(
    "text",
    [
        _urdf("<visual><geometry><cone/></geometry></visual>"),
        _sdf("<visual name='v'><geometry><heightmap/></geometry></visual>"),
    ],
)
def test_geometry_that_cannot_be_read_is_an_unsupported_asset(text: str) -> None:
    assert _error(text=text).code is CODES.UNSUPPORTED_ASSETS


def test_pipe_as_a_mesh_or_buffer_is_not_opened(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.obj")
    visual = "<visual name='v'><geometry><mesh><uri>a.obj</uri></mesh></geometry></visual>"
    assert _error(str(_write(tmp_path / "model.sdf", _sdf(visual)))).code is CODES.UNSUPPORTED_ASSETS


def test_broken_mesh_as_the_resource_itself_is_a_parse_error(tmp_path: Path) -> None:
    path = _write(tmp_path / "a.obj", "v 1 x\n")
    assert _error(str(path)).code is CODES.RESOURCE_PARSE_ERROR


# Lists


def test_formats_have_the_names_of_the_standard() -> None:
    assert set(SPAWN_FORMATS) >= {"urdf", "sdf", "glb", "obj"}


def test_folder_is_searched_for_models_and_lone_meshes(tmp_path: Path) -> None:
    _write(tmp_path / "lamp" / "model.sdf", _sdf())
    _write(tmp_path / "lamp" / "model.config", "<model><description> A \n lamp. </description></model>")
    write_square_obj(tmp_path / "lamp" / "parts", "t.png")
    _write(tmp_path / "crate" / "crate.urdf", _urdf())
    write_square_obj(tmp_path / "crate" / "stuff", "t.png")
    write_square_obj(tmp_path / "scan", "t.png")
    _write(tmp_path / "w.sdf", "<sdf><world name='w'><model name='m'/></world></sdf>")
    _write(tmp_path / "notes.txt", "x")
    _write(tmp_path / ".hidden" / "model.sdf", _sdf())
    found = [s for s in find_spawnables([str(tmp_path)]) if s.uri.startswith("file:")]
    assert [s.uri for s in found] == [(tmp_path / name).as_uri() for name in ("crate", "lamp", "scan/square.obj")]
    assert found[1].description == "A lamp."
    assert all(s.bounds is None for s in found)
    assert _body(found[0].uri).model.name == "crate"


def test_bounds_of_our_robot_hold_its_footprint_and_height() -> None:
    (bot,) = [s for s in find_spawnables(()) if s.uri == "gibson_bot"]
    robot = _load("gibson_bot")
    assert isinstance(robot, RobotSpec)
    assert bot.bounds == ((-robot.radius, -robot.radius, 0.0), (robot.radius, robot.radius, robot.height))


def test_built_in_models_are_sorted_and_come_first(tmp_path: Path) -> None:
    _write(tmp_path / "a.urdf", _urdf())
    uris = [s.uri for s in find_spawnables([str(tmp_path)])]
    assert uris[:-1] == sorted(uris[:-1])
    assert "gibson_bot" in uris
    assert uris[-1].startswith("file:")


@pytest.mark.parametrize("source", ["", "/nowhere", "http://example.org"])
def test_missing_source_is_an_error(source: str) -> None:
    with pytest.raises(SceneNotFoundError):
        find_spawnables([source])


def test_everything_is_in_one_module() -> None:
    assert set(spawning.__all__) >= {
        "SPAWN_FORMATS",
        "SpawnError",
        "SpawnFailure",
        "find_spawnables",
        "load_spawnable",
        "spawn_name",
    }


@pytest.mark.parametrize("count", [MAX_PARTS, MAX_PARTS + 1])
def test_meshes_of_a_thing_are_counted_before_they_are_read(tmp_path: Path, count: int) -> None:
    gltf = Gltf().triangle([[0, 0, 0], [1, 0, 0], [0, 1, 1]])
    gltf.document["nodes"] = [{"mesh": 0, "translation": [0, 0, number % 7]} for number in range(count)]
    gltf.document["scenes"] = [{"nodes": list(range(count))}]
    path = gltf.write(tmp_path / "many.glb")
    if count <= MAX_PARTS:
        assert _body(str(path)).name == "thing"
    else:
        error = _error(str(path))
        assert (error.code, str(MAX_PARTS) in str(error)) == (CODES.RESOURCE_PARSE_ERROR, True)


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
def test_values_of_a_gltf_are_counted_before_they_are_read(tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch) -> None:
    gltf = Gltf().triangle()
    gltf.document["extras"] = [0] * 2_100_000
    path = gltf.write(tmp_path / f"long{suffix}")
    monkeypatch.setattr("gibson_sim.formats.gltf.json.loads", lambda _: pytest.fail("it was read"))
    error = _error(str(path))
    assert error.code is CODES.RESOURCE_PARSE_ERROR
    assert "JSON values, must have at most 2000000" in error.public


def test_malicious_model_name_costs_no_time() -> None:
    name = "_1" * 200_000 + "x"
    assert len(class_from_model(name)) <= 200
    assert effort(lambda: class_from_model(name)) < 10.0, "going back over it takes minutes"


def test_nodes_of_a_gltf_are_counted_before_they_are_traversed(tmp_path: Path) -> None:
    nodes = [{"mesh": 0}] * (10 * MAX_PARTS + 1)
    text = json.dumps({"asset": {"version": "2.0"}, "nodes": nodes, "meshes": [{"primitives": []}]})
    (tmp_path / "a.gltf").write_text(text)
    assert "has 20001 nodes, must have at most 20000" in str(_error(str(tmp_path / "a.gltf")))


def test_links_of_a_urdf_are_counted_before_they_are_read() -> None:
    links = "".join(f"<link name='l{k}'/>" for k in range(20_000))
    assert "has 20000 links, must be at most 500" in str(_error(text=f"<robot name='r'>{links}</robot>"))
