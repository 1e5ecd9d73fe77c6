"""``gibson-sim scene robot --new``: from a xacro, as a maker publishes it, to a file, a test drive and a report."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import yaml

from gibson_sim.cli.command_line import run
from gibson_sim.errors import RenderError
from gibson_sim.robots.load import load_robot
from gibson_sim_tools.robots import picture

INERTIAL = '<inertial><mass value="{}"/><inertia ixx="0.05" ixy="0" ixz="0" iyy="0.05" iyz="0" izz="0.05"/></inertial>'
ROBOT = """<robot name="rover" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arg name="track" default="0.4"/>
<xacro:include filename="$(find new_robot_parts)/urdf/wheel.xacro"/><xacro:include filename="$(find new_robot_parts)/urdf/wheel.xacro"/>
<xacro:include filename="$(find gazebo_things_that_are_gone)/urdf/plugins.xacro"/><xacro:gazebo_plugins/>
<link name="base_link">{base}<collision><origin xyz="0 0 0.08"/><geometry><box size="0.4 0.3 0.1"/></geometry></collision>
<visual><origin xyz="0 0 0.08"/><geometry><mesh filename="package://new_robot_parts/meshes/gone.dae"/></geometry></visual></link>
<xacro:wheel side="left" y="${{$(arg track) / 2}}"/><xacro:wheel side="right" y="${{-$(arg track) / 2}}"/>
<link name="ball">{ball}<collision><geometry><sphere radius="0.02"/></geometry></collision></link>
<joint name="ball_joint" type="fixed"><parent link="base_link"/><child link="ball"/><origin xyz="-0.15 0 -0.06"/></joint>
<link name="laser_link"/><joint name="l" type="fixed"><parent link="base_link"/><child link="laser_link"/><origin xyz="0.1 0 0.2"/></joint>
</robot>"""
WHEEL = """<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:macro name="wheel" params="side y"><link name="${{side}}_wheel">{inertial}
<collision><origin rpy="1.5707963 0 0"/><geometry><cylinder radius="0.08" length="0.04"/></geometry></collision></link>
<joint name="${{side}}_wheel_joint" type="continuous"><parent link="base_link"/><child link="${{side}}_wheel"/><origin xyz="0.05 ${{y}} 0"/>
<axis xyz="0 1 0"/></joint></xacro:macro></robot>"""


@pytest.fixture
def rover(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A xacro with its parts in the package of another repository, an accessory that is nowhere, and a mesh that is missing."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    texts = {
        "rover_repository/rover_description": (
            "rover_description",
            "rover.urdf.xacro",
            ROBOT.format(base=INERTIAL.format(8), ball=INERTIAL.format(0.1)),
        ),
        "parts_repository/any_folder": ("new_robot_parts", "wheel.xacro", WHEEL.format(inertial=INERTIAL.format(0.5))),
    }
    for place, (package, name, text) in texts.items():
        (tmp_path / place / "urdf").mkdir(parents=True)
        (tmp_path / place / "package.xml").write_text(f"<package><name>{package}</name></package>")
        (tmp_path / place / "urdf" / name).write_text(text)
    return tmp_path / "rover_repository/rover_description/urdf/rover.urdf.xacro"


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(picture, "robot_picture", lambda *args, **kwargs: np.zeros((8, 8, 3), np.uint8))


@pytest.mark.usefixtures("drawn")
def test_a_xacro_becomes_a_robot_that_drives(
    rover: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    assert run(["scene", "robot", "--new", str(rover), "--xacro-arg", "track:=0.5"]) == 0
    said = capsys.readouterr().out
    text = (tmp_path / "robot.yaml").read_text()
    values = yaml.safe_load(text)
    assert values["urdf"] == "rover_repository/rover_description/urdf/rover.urdf.xacro"
    assert values["xacro_args"] == {"track": "0.5"}
    assert values["lidar"] == {"link": "laser_link"}
    assert (values["drive"]["type"], values["drive"]["left_joint"]) == ("differential", "left_wheel_joint")
    # Each guess is printed, and stands in the file above its key.
    guesses = re.findall(r"^guessed (\w+): ", said, re.MULTILINE)
    assert guesses == ["drive", "wheel_radius", "base_height", "friction", "lidar"]
    for key, above in (
        ("drive", "# guessed wheel_radius: "),
        ("lidar", "# guessed lidar: "),
        ("base_height", "# guessed base_height: "),
    ):
        before = text[: text.index(f"\n{key}:")].splitlines()
        assert before[-1].startswith(above)
    for line in (
        "at rest: tilt 0.0",
        "support polygon: ",
        "static stability margin: ",
        "1 m forward: ",
        "turn of 360 degrees: ",
        "topic: scan",
    ):
        assert f"\n{line}" in said
    assert "set by hand: lidar at laser_link: beams" in said
    assert "set by hand: description: rover.urdf: link 'base_link': its collision shapes are drawn" in said
    warnings = [record.getMessage() for record in caplog.records]
    assert len(warnings) == len(set(warnings)) == 1 and "package 'gazebo_things_that_are_gone' is not found" in warnings[0]
    assert (tmp_path / "robot.png").is_file() and "run it: gibson-sim run --robot robot.yaml" in said
    found = re.search(r"1 m forward: ([\d.]+) m.*\nturn of 360 degrees: ([\d.]+)", said)
    assert found is not None
    assert [float(found[1]), float(found[2])] == [pytest.approx(1.0, abs=0.01), pytest.approx(360.0, abs=4.0)]
    drive = load_robot(tmp_path / "robot.yaml").drive
    assert drive is not None and drive.wheel_separation == pytest.approx(0.5)  # type: ignore[union-attr]


@pytest.mark.usefixtures("drawn")
def test_a_robot_is_tried_again_after_changes(rover: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["scene", "robot", "--new", str(rover), "--output", "rover.yaml"]) == 0
    file = tmp_path / "rover.yaml"
    file.write_text(file.read_text().replace("type: differential", "type: differential, slip: 0.2"))
    capsys.readouterr()
    assert run(["scene", "robot", str(file), "--trial"]) == 0
    said = capsys.readouterr().out
    assert "1 m forward: 0.8" in said and "guessed" not in said and not (tmp_path / "robot.png").exists()


def test_a_machine_that_cannot_draw_gets_all_but_the_picture(
    rover: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(*args: object, **kwargs: object) -> None:
        raise RenderError("no device draws")

    monkeypatch.setattr(picture, "robot_picture", fail)
    assert run(["scene", "robot", "--new", str(rover)]) == 0
    assert "no picture: no device draws" in capsys.readouterr().out
    assert run(["scene", "robot", "robot.yaml", "--picture", "a.png"]) != 0


def test_files_are_never_overwritten_and_options_are_checked(
    rover: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "robot.yaml").write_text("urdf: mine.urdf\n")
    for arguments, said in (
        (["--new", str(rover)], "robot.yaml: already exists; name another file with --output, or remove it"),
        (["--new", str(rover), "--output", "robot.txt"], "must end in .yaml"),
        (["--new", "robot.yaml"], "is a robot.yaml already: test it with --trial"),
        ([str(rover), "--xacro-arg", "track:=1"], "--xacro-arg goes with --new"),
        (["--new", str(rover), "--output", "b.yaml", "--xacro-arg", "track"], "must be NAME:=VALUE"),
    ):
        assert run(["scene", "robot", *arguments]) != 0
        assert said in capsys.readouterr().err
    assert (tmp_path / "robot.yaml").read_text() == "urdf: mine.urdf\n"
    assert not (tmp_path / "b.yaml").exists()
