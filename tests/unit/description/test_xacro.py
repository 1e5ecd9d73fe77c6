"""Descriptions that must be expanded before they are URDF."""

from __future__ import annotations

import importlib.util
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from xml.etree import ElementTree

import pytest

from gibson_sim.description import xacro
from gibson_sim.description.urdf import parse_urdf, read_urdf
from gibson_sim.description.xacro import plain_description, published_description
from gibson_sim.errors import RobotError
from gibson_sim.robots.load import load_robot
from support.effort import effort

XACRO = """<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arg name="wide" default="0.2"/>
<xacro:include filename="$(find my_robot)/parts/arm.xacro"/>
<link name="base"><visual><geometry><mesh filename="package://my_robot/meshes/a.stl"/></geometry></visual>
<visual><geometry><mesh filename="package://my_robot/meshes/gone.stl"/></geometry></visual>
<collision><geometry><box size="$(arg wide) 0.1 ${2 * 0.3}"/></geometry></collision></link></robot>"""
TWO_LINKS = '<link name="{0}"/><joint name="j" type="fixed"><parent link="{1}"/><child link="{0}"/>{2}</joint>'
ARM = f'<robot xmlns:xacro="http://www.ros.org/wiki/xacro">{TWO_LINKS.format("arm", "base", "")}</robot>'
OPTIONAL = f'<robot name="r"><link name="a"/>{TWO_LINKS.format("b", "a", """<origin xyz="$(optenv SECRET 1 2 3)"/>""")}</robot>'


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A ROS package with a xacro, what it includes, and one of the two meshes that it names."""
    folder = tmp_path / "ws" / "my_robot"
    for name, text in (("urdf/r.urdf.xacro", XACRO), ("parts/arm.xacro", ARM), ("meshes/a.stl", "")):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    return folder


@pytest.fixture
def needs_xacro() -> None:
    if importlib.util.find_spec("xacro") is None:
        message = "SKIPPED: the xacro package is not installed; pip install xacro"
        warnings.warn(message, stacklevel=2)
        pytest.skip(message)


def test_a_plain_urdf_is_used_unchanged(root: Path) -> None:
    path = root / "config/robots/gibson_bot/gibson_bot.urdf"
    assert plain_description(path, {}) == path


def test_without_the_package_a_xacro_is_refused_with_the_remedy(package: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(xacro, "find_spec", lambda name: None)
    with pytest.raises(RobotError, match=r"r\.urdf\.xacro: is a xacro; install the package xacro \(pip install xacro\)"):
        plain_description(package / "urdf/r.urdf.xacro", {})


@pytest.mark.usefixtures("needs_xacro")
def test_a_xacro_is_expanded_with_its_arguments_and_packages(package: Path) -> None:
    (package / "robot.yaml").write_text("urdf: urdf/r.urdf.xacro\nxacro_args: {wide: 0.5}\n")
    robot = load_robot(package)
    model = read_urdf(robot.urdf)
    assert [link.name for link in model.links] == ["base", "arm"]
    assert model.link("base").collisions[0].shape.size == (0.5, 0.1, 0.6)
    assert [visual.shape.mesh for visual in model.link("base").visuals] == [str(package / "meshes/a.stl")]
    assert model.warnings == ("r.urdf: link 'base': visual: mesh package://my_robot/meshes/gone.stl does not exist; left out",)
    assert robot.urdf == plain_description(package / "urdf/r.urdf.xacro", {"wide": "0.5"})


@pytest.mark.usefixtures("needs_xacro")
def test_xacro_errors_are_one_line(package: Path) -> None:
    path = package / "urdf/r.urdf.xacro"
    path.write_text(XACRO.replace("2 * 0.3", "nothing"))
    with pytest.raises(RobotError, match="xacro rejects it: name 'nothing' is not defined") as error:
        plain_description(path, {})
    assert "\n" not in str(error.value)


@pytest.mark.usefixtures("needs_xacro")
@pytest.mark.parametrize("value", ["${9**9**9}", "${'x' * 10**10}"])
def test_xacro_beyond_its_limits_of_time_and_memory_is_refused(
    tmp_path: Path, value: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(xacro, "_MODULE", "xacro_in_a_hurry")
    (tmp_path / "xacro_in_a_hurry.py").write_text(
        "from gibson_sim.description import xacro_process\nxacro_process.LIMIT_S = 1\nxacro_process.main()\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    path = tmp_path / "r.xacro"
    path.write_text(f'<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro"><link name="{value}"/></robot>')
    with pytest.raises(RobotError, match=r"r\.xacro: xacro (did not finish within|rejects it)"):
        plain_description(path, {})


@pytest.mark.parametrize(
    "text",
    [
        "<!-- $(optenv " + "a" * 300_000 + " -->",
        "<!-- " + "$(optenv a " * 100_000 + " -->",
        "<!-- $(optenv a" + " " * 300_000 + " -->",
    ],
)
def test_optional_variables_without_an_end_cost_no_time(tmp_path: Path, text: str) -> None:
    path = tmp_path / "r.urdf"
    path.write_text(f'<robot name="r"><link name="base"/>{text}</robot>')
    found: list[Path] = []
    assert effort(lambda: found.append(plain_description(path, {}))) < 10.0, "going back over them takes minutes"
    assert found == [path]


def test_text_that_resembles_xacro_is_not_expanded_and_costs_no_time() -> None:
    comments = "<!--" * 200_000
    texts = (
        f'<!DOCTYPE robot SYSTEM "{comments}"><robot><!-- <xacro:a/> --></robot>',
        "<robot><!-- <xacro:a/> --><![CDATA[<xacro:b/>]]><?x <xacro:c/>?></robot>",
        "<robot><!-- a --><xacro:b/><!-- c --></robot>",
        "<robot><xacro:b/></robot>",
    )
    found: list[bool] = []
    top = ElementTree.Element("robot")
    assert effort(lambda: found.extend(xacro.is_xacro(text, top) for text in texts)) < 10.0, "going back over them takes minutes"
    assert found == [False, False, True, True]


def test_arguments_of_a_plain_urdf_are_refused(tmp_path: Path) -> None:
    (tmp_path / "r.urdf").write_text('<robot name="r"><link name="a"/></robot>')
    (tmp_path / "robot.yaml").write_text("urdf: r.urdf\nradius: 1\nheight: 1\nxacro_args: {a: 1}\n")
    with pytest.raises(RobotError, match="xacro_args are given, but this is not a xacro"):
        load_robot(tmp_path)
    (tmp_path / "robot.yaml").write_text("urdf: r.urdf\nxacro_args: {a: [1]}\n")
    with pytest.raises(RobotError, match="must be a text, a number, true or false"):
        load_robot(tmp_path)


def test_an_optional_variable_has_its_default_wherever_the_robot_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SECRET", "7 8 9")
    assert parse_urdf(OPTIONAL, Path("r.urdf")).joint("j").pose.position == (1.0, 2.0, 3.0)
    path = tmp_path / "r.urdf"
    path.write_text(OPTIONAL)
    assert "$(" not in plain_description(path, {}).read_text()


def test_a_description_may_lie_in_an_installed_python_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "site" / "some_robot_data"
    folder.mkdir(parents=True)
    (folder / "r.urdf").write_text('<robot name="r"><link name="a"/></robot>')
    far = tmp_path / "no" / "folder" / "above" / "has" / "it"
    far.mkdir(parents=True)
    (far / "robot.yaml").write_text("urdf: package://some_robot_data/r.urdf\nradius: 1\nheight: 1\n")
    with pytest.raises(RobotError, match=r"urdf package://some_robot_data/r\.urdf is not found: looked in .*no/folder/above"):
        load_robot(far)
    (folder / "__init__.py").write_text("raise RuntimeError('this must not be imported')")
    monkeypatch.syspath_prepend(str(tmp_path / "site"))
    assert load_robot(far).urdf == folder / "r.urdf"


def test_a_published_description_has_mesh_uris_that_other_nodes_resolve(root: Path, tmp_path: Path) -> None:
    path = root / "config/robots/arm_bot/arm_bot.urdf"
    text = published_description(path)
    assert (root / "config/robots/arm_bot/meshes/finger.glb").as_uri() in text
    assert '"meshes/' not in text
    plain = tmp_path / "r.urdf"
    plain.write_text('<robot name="r"><!-- as it is --><link name="a"/></robot>')
    assert published_description(plain) == plain.read_text()


def write_package(folder: Path, files: dict[str, str]) -> Path:
    """Makes a package; macros and links of ``files`` are in a <robot> with the xacro namespace."""
    (folder / "urdf").mkdir(parents=True)
    (folder / "package.xml").write_text(f"<package><name>{folder.name}</name></package>")
    for name, inside in files.items():
        text = f'<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">{inside}</robot>'
        (folder / "urdf" / name).write_text(text)
    return folder


def link_below(name: str, parent: str) -> str:
    return TWO_LINKS.format(name, parent, "").replace('"j"', f'"{name}_joint"')


@pytest.mark.usefixtures("needs_xacro")
def test_included_xacros_may_name_packages_as_often_as_they_like(tmp_path: Path) -> None:
    folder = tmp_path / "a work space"
    include = '<xacro:include filename="$(find {})/urdf/{}"/>'.format
    base = include("arm_description", "arm.xacro") + include("tool_description", "tool.xacro")
    write_package(folder / "base_description", {"r.urdf.xacro": base + '<link name="base"/><xacro:arm/><xacro:tool/>'})
    # Both include the same file, which names two packages that the top one does not.
    common = include("common_description", "common.xacro")
    arm = f'<xacro:macro name="arm">{link_below("arm", "base")}<xacro:marker at="arm"/></xacro:macro>'
    tool = f'<xacro:macro name="tool">{link_below("tool", "arm")}<xacro:marker at="tool"/></xacro:macro>'
    write_package(folder / "arm_description", {"arm.xacro": common + arm})
    write_package(folder / "tool_description", {"tool.xacro": common + tool})
    properties = '<xacro:property name="here" value="$(find common_description)"/>' + include("sizes_description", "sizes.xacro")
    marker = link_below("${at}_marker", "${at}")
    marker = f'<xacro:macro name="marker" params="at">{marker}</xacro:macro>'
    write_package(folder / "common_description", {"common.xacro": properties + marker})
    write_package(folder / "sizes_description", {"sizes.xacro": '<xacro:property name="size" value="$(find arm_description)"/>'})
    model = read_urdf(plain_description(folder / "base_description/urdf/r.urdf.xacro", {}))
    assert [link.name for link in model.links] == ["base", "arm", "arm_marker", "tool", "tool_marker"]


@pytest.mark.usefixtures("needs_xacro")
def test_packages_are_found_in_other_repositories_of_a_workspace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    include = '<xacro:include filename="$(find {}_description)/urdf/{}.xacro"/>'.format
    source = tmp_path / "ws/src"
    top = write_package(
        source / "our_repository/base_description", {"r.urdf.xacro": include("arm", "arm") + '<link name="base"/>'}
    )
    # The arm is installed elsewhere, beside the package that it names.
    prefix = tmp_path / "installed"
    write_package(source / "their_repository/arm_description", {"arm.xacro": include("tool", "tool")})
    write_package(prefix / "share/tool_description", {"tool.xacro": include("bit", "bit")})
    write_package(prefix / "share/bit_description", {"bit.xacro": link_below("bit", "base")})
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(prefix))
    # Files in the current folder do not shadow xacro's modules.
    monkeypatch.chdir(tmp_path)
    (tmp_path / "yaml.py").write_text("raise RuntimeError('this must not be imported')")
    model = read_urdf(plain_description(top / "urdf/r.urdf.xacro", {}))
    assert [link.name for link in model.links] == ["base", "bit"]


@pytest.mark.usefixtures("needs_xacro")
def test_packages_are_found_beside_by_the_name_in_their_manifest(tmp_path: Path) -> None:
    """As makers publish: each repository in a folder of its own, packages some levels down, folders with other names."""
    include = '<xacro:include filename="$(find {}_description)/urdf/{}.xacro"/>'.format
    # Named twice, by two files: once this ended in a FileExistsError.
    twice = include("sideways_base", "base") * 2 + include("sideways_base", "tool")
    top = write_package(tmp_path / "robot_repository/robot_description", {"r.urdf.xacro": twice})
    (top / "package.xml").write_text("<package><name>robot_description</name></package>")
    for place in ("base_repository/common/sources_of_base", "another_repository/copy_of_base"):
        parts = {"base.xacro": include("sideways_base", "pi"), "pi.xacro": "", "tool.xacro": '<link name="base"/>'}
        inside = write_package(tmp_path / place, parts)
        (inside / "package.xml").write_text("<package><name>sideways_base_description</name></package>")
    mesh = (
        '<link name="a"><visual><geometry><mesh filename="package://sideways_base_description/a.stl"/></geometry></visual></link>'
    )
    for place in ("base_repository/common/sources_of_base", "another_repository/copy_of_base"):
        (tmp_path / place / "a.stl").write_text("")
    assert [link.name for link in read_urdf(plain_description(top / "urdf/r.urdf.xacro", {})).links] == ["base"]
    found = parse_urdf(f'<robot name="r">{mesh}</robot>', top / "urdf/r.urdf").links[0].visuals[0].shape.mesh
    assert found == str(tmp_path / "another_repository/copy_of_base/a.stl")


@pytest.mark.usefixtures("needs_xacro")
def test_a_missing_package_is_named_with_the_folders_and_the_remedy(tmp_path: Path) -> None:
    include = '<xacro:include filename="$(find gone_description)/urdf/arm.xacro"/>'
    # Warnings of xacro precede its error.
    redefined = '<xacro:property name="pi" value="3"/><xacro:property name="a" value="1"/>'
    top = write_package(tmp_path / "base_description", {"r.urdf.xacro": redefined + include + '<xacro:gone_arm name="b"/>'})
    with pytest.raises(RobotError) as caught:
        plain_description(top / "urdf/r.urdf.xacro", {})
    said = str(caught.value)
    assert "package 'gone_description' is not found: looked in " in said and f"{tmp_path}" in said
    assert said.endswith("without it xacro rejects it: unknown macro name: xacro:gone_arm") and "\n" not in said
    assert "source the workspace that has it" in said and "$AMENT_PREFIX_PATH (" in said


@pytest.mark.usefixtures("needs_xacro")
def test_packages_that_a_robot_does_not_need_may_be_missing(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Accessories that are not mounted, plugins of another simulator, a file of another version of a package."""
    include = '<xacro:include filename="$(find {0}_is_gone)/urdf/{0}.xacro"/>'.format
    lidar = '<xacro:if value="false"><xacro:some_lidar/></xacro:if>'
    plugins = '<xacro:gazebo_diff_drive left="l"/>'
    gone = '<xacro:include filename="nowhere.xacro"/>'
    text = include("lidar") + include("gazebo") + lidar + plugins + gone + '<link name="base"/>'
    top = write_package(tmp_path / "base_description", {"r.urdf.xacro": text})
    for _ in range(2):
        assert [link.name for link in read_urdf(plain_description(top / "urdf/r.urdf.xacro", {})).links] == ["base"]
    lines = [record.getMessage() for record in caplog.records]
    assert len(lines) == 2, "one line for the packages and one for the file, once"
    assert lines[0].startswith("r.urdf.xacro: packages 'lidar_is_gone', 'gazebo_is_gone' are not found: looked in ")
    assert lines[1].startswith(f"r.urdf.xacro: included file {top}/urdf/nowhere.xacro does not exist")


@pytest.mark.usefixtures("needs_xacro")
def test_a_robot_that_is_all_in_a_missing_package_is_refused_by_its_name(tmp_path: Path) -> None:
    include = '<xacro:include filename="$(find all_of_it_is_gone)/urdf/robot.xacro"/>'
    top = write_package(tmp_path / "base_description", {"r.urdf.xacro": include})
    with pytest.raises(
        RobotError, match=r"package 'all_of_it_is_gone' is not found: .*; without it the file expands to no <link>"
    ):
        plain_description(top / "urdf/r.urdf.xacro", {})


@pytest.mark.usefixtures("needs_xacro")
def test_runs_at_the_same_time_share_the_cache(package: Path) -> None:
    with ThreadPoolExecutor(4) as pool:
        paths = list(pool.map(lambda _: plain_description(package / "urdf/r.urdf.xacro", {"wide": "0.3"}), range(4)))
    assert len(set(paths)) == 1
    assert [file.name for file in paths[0].parent.iterdir()] == ["r.urdf"]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:macro name="wheel"><link name="a"/></xacro:macro></robot>',
         "expands to no <link>; if it only defines macros, give the xacro that calls them"),
        ('<sdf version="1.7" xmlns:xacro="http://www.ros.org/wiki/xacro"><model name="m"><link name="a"/></model></sdf>',
         "expands to an SDF model, which is spawned as a body"),
    ],
)  # fmt: skip
def test_expansion_to_something_other_than_a_robot_is_refused_with_the_xacro_file(
    needs_xacro: None, tmp_path: Path, text: str, said: str
) -> None:
    file = tmp_path / "part.urdf.xacro"
    file.write_text(text)
    with pytest.raises(RobotError) as caught:
        plain_description(file, {})
    assert str(caught.value).startswith(f"{file}: ") and said in str(caught.value)
