"""The launch file: its arguments, the parameters of its nodes, and its reaction to the end of a node."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from gibson_sim.cli.commands.params import allowed
from gibson_sim.cli.launching import CONFIGS, VIEWERS, LaunchPlan, arguments, plan
from gibson_sim.config import PhysicsConfig
from gibson_sim.errors import GibsonSimError
from gibson_sim.ros.nodes import start
from gibson_sim.settings import make_settings, setting_fields
from support.launching import Context, Exit, LaunchFile, Said

ALL_OF_A_FILE = """
/**:
  ros__parameters: {seed: 3, jpeg_quality: 60, png_level: 1, other: 1}
physics:
  ros__parameters: {seed: 4, rate: 2, use_sim_time: false}
sim:
  render:
    ros__parameters: {jpeg_quality: 70}
/**/render:
  ros__parameters: {png_level: 2}
planner:
  ros__parameters: {seeds: 3}
"""


@pytest.fixture
def launch_file(root: Path, monkeypatch: pytest.MonkeyPatch) -> LaunchFile:
    """The launch file of the simulation."""
    return LaunchFile(root / "src" / "gibson_sim" / "launch" / "sim.launch.py", monkeypatch)


@pytest.fixture
def params_file(tmp_path: Path) -> Path:
    """A file with parameters for several nodes in several namespaces."""
    path = tmp_path / "params.yaml"
    path.write_text(ALL_OF_A_FILE)
    return path


def _parameters(given: LaunchPlan) -> dict[str, dict[str, Any]]:
    return {start.node: start.parameters for start in given.nodes}


def test_every_parameter_of_every_node_is_an_argument_with_its_meaning_and_limits(launch_file: LaunchFile) -> None:
    declared = {action.given[0]: action.options for action in launch_file.of_kind("DeclareLaunchArgument")}
    assert list(declared) == [argument.name for argument in arguments()]
    settings = [(node, f) for node, cls in CONFIGS.items() for f in setting_fields(cls)]
    names = [f.name for _, f in settings]
    settings += [(node, f) for node, cls in VIEWERS.items() for f in setting_fields(cls)]
    for node, f in settings:
        options = declared.pop(f.name if names.count(f.name) == 1 and node in CONFIGS else f"{node}_{f.name}")
        assert f.metadata["doc"] in options["description"]
        assert f"({node} node)" in options["description"]
        assert options["choices"] == (list(f.metadata["choices"]) or None)
        assert options["choices"] or allowed(f) in options["description"]
        assert options["default_value"] == (str(f.default).lower() if isinstance(f.default, bool) else str(f.default))
    assert list(declared) == [
        "params_file", "namespace", "render", "use_sim_time", "reach", "web", "foxglove", "rviz", "rviz_config", "rviz_frame",
    ]  # fmt: skip


def test_arguments_that_are_not_given_reach_no_node() -> None:
    assert _parameters(plan({})) == {"physics": {}, "render": {}}
    assert _parameters(plan({"seed": "7", "foreign": "x"})) == {"physics": {"seed": 7}, "render": {}}


def test_defaults_given_as_text_are_the_defaults() -> None:
    given = _parameters(plan({argument.name: argument.default for argument in arguments()}))
    assert given["render"].pop("use_sim_time") is False
    for node, cls in CONFIGS.items():
        assert make_settings(cls, given[node]) == cls()
        assert [type(value) for value in given[node].values()] == [type(f.default) for f in setting_fields(cls)]


def test_arguments_win_over_every_section_of_a_file_and_the_rest_of_it_stays(params_file: Path) -> None:
    given = plan({"params_file": str(params_file), "namespace": "/sim/", "seed": "9", "jpeg_quality": "80", "rate": "max"})
    assert given.namespace == "sim"
    assert _parameters(given) == {"physics": {"seed": 9, "rate": 0.0}, "render": {"jpeg_quality": 80}}
    physics, render = (json.loads(given.overriding(start)) for start in given.nodes)
    wins = {"ros__parameters": {"seed": 9, "rate": 0.0}}
    assert physics == {"/**": wins, "physics": wins, "sim": {"render": wins}, "/**/render": wins, "planner": wins}
    assert render["sim"] == {"render": {"ros__parameters": {"jpeg_quality": 80}}}


def test_parameter_file_alone_is_checked_before_anything_starts(params_file: Path) -> None:
    assert _parameters(plan({"params_file": str(params_file)})) == {"physics": {}, "render": {}}
    params_file.write_text("physics:\n  ros__parameters: {lockstep: true, participants: 'render; nav=cmd_vel after odom'}\n")
    assert _parameters(plan({"params_file": str(params_file)}))["physics"] == {}


def test_time_of_lockstep_waits_for_the_render_node_in_its_namespace(tmp_path: Path) -> None:
    assert _parameters(plan({"lockstep": "true"}))["physics"] == {"lockstep": True, "participants": "render"}
    within = _parameters(plan({"lockstep": "true", "namespace": "sim", "ros_namespace": "/a"}))
    assert within["physics"]["participants"] == "a/sim/render"
    assert _parameters(plan({"lockstep": "true", "participants": "nav"}))["physics"]["participants"] == "nav"
    assert _parameters(plan({"lockstep": "true", "render": "False"})) == {"physics": {"lockstep": True}}
    (tmp_path / "p.yaml").write_text("/**: {ros__parameters: {participants: 'render; mine', lockstep: true}}")
    given = plan({"lockstep": "true", "params_file": str(tmp_path / "p.yaml")})
    assert _parameters(given)["physics"]["participants"] == "render; mine"


@pytest.mark.parametrize(
    ("argument", "error"),
    [
        ("map:=onn", "setting 'map' is 'onn', must be one of auto, on, off; did you mean 'on'?"),
        ("rate:=fast", "argument 'rate' is 'fast', must be a number, or max"),
        ("seed:=1.5", "argument 'seed' is '1.5', must be a whole number"),
        ("seed:=-1", "setting 'seed' is -1, must be 0 or more"),
        ("lockstep:=maybe", "argument 'lockstep' is 'maybe', must be true or false"),
        ("render:=", "argument 'render' is '', must be true or false"),
        ("scene:=lindn_flat", "did you mean 'linden_flat'"),
        ("cmd_vel_timeout:=nan", "argument 'cmd_vel_timeout' is 'nan', must be a number"),
        ("step_hz:=100", "must divide 'step_hz', which is 100 Hz"),
        ("params_file:=/no/such.yaml", "params_file /no/such.yaml: cannot be read: No such file"),
    ],
)
def test_impossible_argument_is_refused_in_one_line(argument: str, error: str) -> None:
    with pytest.raises(GibsonSimError) as found:
        plan(dict([argument.split(":=")]))
    assert error in str(found.value)
    assert "\n" not in str(found.value)


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("a: [", "is not YAML: line "),
        ("", "has no parameters; it must be like"),
        ("- a", "has no parameters"),
        ("physics: {seed: 3}", "has no parameters"),
        ("physics: {ros__parameters: [1]}", "physics: ros__parameters must be a list of 'name: value' lines"),
        ("render: {ros__parameters: {jpg_quality: 3}}", "render has no parameter 'jpg_quality'; did you mean 'jpeg_quality'?"),
        ("physics: {ros__parameters: {step_hz: 100}}", "must divide 'step_hz', which is 100 Hz"),
        ("/**: {ros__parameters: {scene: no_such_flat}}", "scene 'no_such_flat' is not found"),
    ],
)
def test_impossible_file_is_refused_in_one_line(tmp_path: Path, text: str, error: str) -> None:
    (tmp_path / "p.yaml").write_text(text)
    with pytest.raises(GibsonSimError) as found:
        plan({"params_file": str(tmp_path / "p.yaml")})
    assert error in str(found.value)
    assert "\n" not in str(found.value)


def test_programs_that_it_starts_exist_and_get_the_file_before_the_arguments(
    launch_file: LaunchFile, params_file: Path, root: Path
) -> None:
    setup = (root / "src" / "gibson_sim" / "setup.py").read_text()
    nodes = [action for action in launch_file.start(f"params_file:={params_file}", "seed:=5", "sead:=4") if action.kind == "Node"]
    assert launch_file.warnings == ["argument 'sead' is unknown and changes nothing; did you mean 'seed'?"]
    for node in nodes:
        program = node.options["executable"]
        assert f"{program} = gibson_sim.ros.nodes.start:{program}" in setup
        assert callable(getattr(start, program))
        assert node.options["parameters"][0] == str(params_file)
    physics, render = nodes
    assert json.loads(Path(physics.options["parameters"][1]).read_text())["/**"] == {"ros__parameters": {"seed": 5}}
    assert len(render.options["parameters"]) == 1


def test_page_and_foxglove_are_started_on_request_with_their_settings(launch_file: LaunchFile, root: Path) -> None:
    assert [start.node for start in plan({"web_port": "0", "foxglove_port": "0"}).nodes] == ["physics", "render"]
    given = plan({"web": "true", "web_port": "8081", "foxglove": "1", "foxglove_commands": "false"})
    expected = {"physics": {"views": "follow,top"}, "render": {}, "web": {"port": 8081}, "foxglove": {"commands": False}}
    assert _parameters(given) == expected
    assert _parameters(plan({"web": "true", "views": "top"}))["physics"] == {"views": "top"}
    assert _parameters(plan({"web": "true", "render": "false"}))["physics"] == {}
    with pytest.raises(GibsonSimError, match="setting 'token' must have 8 to 128 letters"):
        plan({"web": "true", "web_token": "a b"})
    setup = (root / "src" / "gibson_sim" / "setup.py").read_text()
    nodes = [action for action in launch_file.start("web:=true", "foxglove:=true") if action.kind == "Node"]
    assert [node.options["executable"] for node in nodes] == ["physics_node", "render_node", "web_node", "foxglove_node"]
    for node in nodes:
        program = node.options["executable"]
        assert f"{program} = gibson_sim.ros.nodes.start:{program}" in setup
        assert callable(getattr(start, program))


def test_rviz_gets_an_existing_file_and_an_existing_frame(root: Path, tmp_path: Path) -> None:
    file = str(root / "config" / "sim.rviz")
    assert plan({}).rviz is None
    assert plan({"rviz": "true"}).rviz == ("-d", file, "-f", "odom")
    assert plan({"rviz": "true", "publish_map_tf": "true"}).rviz == ("-d", file, "-f", "map")
    (tmp_path / "p.yaml").write_text("physics: {ros__parameters: {publish_map_tf: true}}")
    assert plan({"rviz": "true", "params_file": str(tmp_path / "p.yaml")}).rviz == ("-d", file, "-f", "map")
    (tmp_path / "own.rviz").write_text("")
    own = plan({"rviz": "true", "rviz_config": str(tmp_path / "own.rviz"), "rviz_frame": "map"})
    assert own.rviz == ("-d", str(tmp_path / "own.rviz"), "-f", "map")
    with pytest.raises(GibsonSimError, match=r"simm\.rviz"):
        plan({"rviz": "true", "rviz_config": "simm.rviz"})


def test_rviz_is_started_where_it_is_installed_and_else_named(
    launch_file: LaunchFile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(
        GibsonSimError, match=r"^rviz:=true needs RViz, which is not installed: `sudo apt install ros-jazzy-rviz2`$"
    ):
        launch_file.start("rviz:=true")
    index = tmp_path / "share" / "ament_index" / "resource_index" / "packages"
    index.mkdir(parents=True)
    (index / "rviz2").touch()
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    started = launch_file.start("rviz:=true", "namespace:=sim")
    rviz = started[-1].options
    assert (rviz["package"], rviz["executable"], rviz["namespace"]) == ("rviz2", "rviz2", "sim")
    assert rviz["parameters"] == [{"use_sim_time": True}]
    assert _ends(started, started[-1], -9, Context()).kind == "LogInfo"


def test_page_that_ends_ends_no_simulation_but_a_taken_port_does(launch_file: LaunchFile) -> None:
    started = launch_file.start("web:=true")
    web = [action for action in started if action.kind == "Node"][-1]
    assert _ends(started, web, -11, Context()).options["msg"] == "the web node has ended; the simulation goes on without it"
    with pytest.raises(RuntimeError, match="the web node ended with code 1, so the simulation ends"):
        _ends(started, web, 1, Context())


def test_reach_is_set_for_the_nodes_alone_and_is_logged(launch_file: LaunchFile) -> None:
    for given, discovery, said in (
        ((), "SYSTEM_DEFAULT", "processes of this machine alone; `reach:=subnet` lets other machines in"),
        (("reach:=subnet",), "SUBNET", "every machine of this network may see and command it"),
    ):
        started = launch_file.start(*given)
        assert said in started[0].options["msg"]
        nodes = [action.options["additional_env"] for action in started if action.kind == "Node"]
        assert [variables["ROS_AUTOMATIC_DISCOVERY_RANGE"] for variables in nodes] == [discovery] * 2
    with pytest.raises(GibsonSimError, match="reach is 'world', must be one of local, subnet"):
        launch_file.start("reach:=world")


def _ends(started: list[Said], action: Said, code: int, context: Context) -> Any:
    (handler,) = [each.given[0] for each in started if each.kind == "RegisterEventHandler"]
    return handler.options["on_exit"](Exit(action, code), context)


def test_all_ends_with_physics_and_a_renderer_that_crashes_comes_back(launch_file: LaunchFile) -> None:
    started = launch_file.start()
    physics, render = [action for action in started if action.kind == "Node"]
    context = Context()
    assert _ends(started, physics, 0, context).kind == "EmitEvent"
    with pytest.raises(RuntimeError, match="the physics node ended with code -11, so the simulation ends"):
        _ends(started, physics, -11, context)
    with pytest.raises(RuntimeError, match="the render node ended with code 1, so"):
        _ends(started, render, 1, context)
    assert _ends(started, render, 0, context).kind == "LogInfo"
    for _ in range(3):
        said, render = _ends(started, render, -6, context)
        assert (said.kind, render.kind, render.options["executable"]) == ("LogInfo", "Node", "render_node")
    with pytest.raises(RuntimeError, match="the render node ended with code -6, so"):
        _ends(started, render, -6, context)
    context.is_shutdown = True
    assert _ends(started, physics, -2, context) is None


def test_shipped_files_hold_the_defaults(root: Path) -> None:
    for node, cls in CONFIGS.items():
        given = plan({"params_file": str(root / "config" / f"{node}.param.yaml")})
        read = given.sections["/**"]["ros__parameters"]
        known = {f.name: f.default for f in setting_fields(cls)}
        assert {name: value for name, value in read.items() if name not in known or known[name] != value} == {}
    assert PhysicsConfig().world.scene == "linden_flat"
