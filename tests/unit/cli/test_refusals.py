"""Names on the command line that do not exist: refused before anything starts, with a list of those that do."""

from __future__ import annotations

from pathlib import Path

import pytest

from gibson_sim.cli.main import main
from gibson_sim.cli.names import check_names
from gibson_sim.client_config import DRIVES, TASK_NAMES, TaskConfig
from gibson_sim.config import PhysicsConfig
from gibson_sim.errors import SceneError
from gibson_sim.robots.path_tracking import scripted_drive
from gibson_sim.tasks.registry import TASKS

WRONG = [
    (("run", "--drive", "squar"), 1, "drive 'squar' is unknown; did you mean 'square'? known: tour, forward, square, spin, keyboard"),
    (("drive", "squar"), 1, "drive 'squar' is unknown; did you mean 'square'? known: tour"),
    (("run", "--scene", "lindenflat"), 1, "scene 'lindenflat' is not found; did you mean 'linden_flat'? known: arena, boulevard_flat"),
    (("drive", "tour", "--scene", "lindenflat"), 1, "did you mean 'linden_flat'?"),
    (("run", "--robot", "gibson_bott"), 1, "robot 'gibson_bott' is not found; did you mean 'gibson_bot'? known: ackermann_bot"),
    (("run", "--robot", "left=gibson_bot,right=gibson_bott"), 1, "robot 'gibson_bott' is not found"),
    (("run", "--robot", "left=gibson_bot,gibson_bot"), 1, "robot 'gibson_bot' must be name=robot where there are several"),
    (("run", "--robot", "left=gibson_bot,left=arm_bot"), 1, "two robots are named 'left'; names must be unique"),
    (("run", "--views", "folow"), 1, "did you mean 'follow'? give follow, orbit, top"),
    (("run", "--camera-outputs", "rgb,dept"), 1, "must be of rgb, depth, semantic"),
    (("run", "--randomise", "exampel"), 1, "did you mean 'example'? known: example"),
    (("run", "--lockstep", "--participants", "a=b"), 1, "'participants' has 'a=b', must be"),
    (("run", "--storage", "sqlite", "--record", "new"), 1, "'storage' is 'sqlite', must be one of mcap, sqlite3; did you mean 'sqlite3'?"),
    (("run", "--topics", "a..b", "--record", "new"), 1, "'topics' has 'a..b', which is not a topic name"),
    (("run", "--asset-roots", "/a=/b=/c"), 1, "'asset_roots' has '/a=/b=/c', must be pairs"),
    (("run", "--asset-roots", "/a=/no/such/folder"), 1, "maps /a to '/no/such/folder', which is not a folder of this machine"),
    (("run", "--asset-roots", "/a=/,/a=/"), 1, "'asset_roots' has '/a' twice"),
    (("run", "--asset-roots", "a=/"), 1, "'asset_roots' has 'a', must be an absolute folder"),
    (("run", "--seed", "-1"), 1, "'seed' is -1, must be 0 or more"),
    (("run", "--rate", "fast"), 2, "argument --rate: 'fast' is neither a number nor max"),
    (("run", "--video", "new.webm"), 1, "--video 'new.webm': the name must end in .mp4"),
    (("run", "--recrod", "x"), 2, "unrecognized arguments: --recrod x; did you mean '--record'?"),
    (("topic", "echo", "/odom", "--csv"), 2, "unrecognized arguments: --csv; see `gibson-sim topic echo --help`"),
    (("topic", "echo", "-l", "/odom"), 2, "unrecognized arguments: -l; see `gibson-sim topic echo --help`"),
    (("topic", "echo", "/odom", "--feild", "pose"), 2, "unrecognized arguments: --feild pose; did you mean '--field'?"),
    (("topic", "hz", "/odom", "--seconds", "-3"), 2, "argument --seconds: '-3' must be a number of seconds, 0 or more"),
    (("topic", "bw", "/odom", "--seconds", "nan"), 2, "argument --seconds: 'nan' must be a number of seconds, 0 or more"),
    (("topic", "delay", "/odom", "--seconds", "abc"), 2, "argument --seconds: 'abc' must be a number of seconds, 0 or more"),
    (("topic", "pbu"), 2, "'pbu' is unknown; known: list, type, info, echo, hz, bw, delay; see"),
    (("runn",), 2, "command 'runn' is unknown; did you mean 'run'? known: action, bag"),
    (("bag", "chek", "x"), 2, "'chek' is unknown; did you mean 'check'? known: check, play, plot, repair"),
    (("export", "a", "b", "--to", "tumm"), 2, "argument --to: 'tumm' is unknown; did you mean 'tum'? known: tum, nerfstudio, lerobot, png"),
    (("demo", "opendoor"), 1, "demo 'opendoor' is unknown; did you mean 'open-door'?"),
    (("task", "point-gaol"), 1, "'task' is 'point-gaol', must be one of point-goal, push-through"),
    (("task", "point-goal", "--baseline", "scriptd"), 1, "must be one of scripted, random, none, careful; did you mean 'scripted'?"),
    (("render", "nosuch", "--output", "new"), 1, "there is no bag at nosuch"),
    (("compare", "nosuch", "nosuch"), 1, "there is no bag at nosuch"),
    (("replay", "nosuch"), 1, "there is no bag at nosuch"),
    (("bag", "play", "nosuch"), 1, "there is no bag at nosuch"),
    (("bag", "play", "nosuch", "--rate", "-1"), 1, "--rate is -1, must be above 0"),
    (("bag", "play", "nosuch", "--ratte", "2"), 2, "did you mean '--rate'?"),
]  # fmt: skip


@pytest.mark.parametrize(("words", "code", "said"), WRONG, ids=lambda value: " ".join(value) if isinstance(value, tuple) else "")
def test_unknown_names_are_refused_in_one_line_before_anything_starts(
    words: tuple[str, ...],
    code: int,
    said: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def start(*_: object, **__: object) -> None:
        pytest.fail("a process was started")

    for place in ("gibson_sim.processes.node_process.subprocess.Popen", "gibson_sim.cli.processes.os.execve"):
        monkeypatch.setattr(place, start)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as end:
        main(list(words))
    error = capsys.readouterr().err
    assert (end.value.code, error.count("\n")) == (code, 1), error
    assert error.startswith("gibson-sim: error: ")
    assert said in error
    assert list(tmp_path.iterdir()) == []


def test_the_second_bag_of_a_comparison_is_checked_before_the_first_is_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "real").mkdir()
    (tmp_path / "real" / "real_0.mcap").write_bytes(b"a bag that nothing could read")
    with pytest.raises(SystemExit):
        main(["compare", str(tmp_path / "real"), str(tmp_path / "sim")])
    assert f"there is no bag at {tmp_path / 'sim'}" in capsys.readouterr().err


def test_a_scene_file_that_is_no_yaml_is_refused_by_the_launcher(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "scene.yaml").write_text("name: [a\nbodies: }\n")
    with pytest.raises(SystemExit) as end:
        main(["run", "--scene", str(tmp_path)])
    assert end.value.code == 1
    assert f"{tmp_path}/scene.yaml: is not YAML" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"", "is not well-formed XML: no element found"),
        (b"<sdf version='1.6'><world", "is not well-formed XML: unclosed token"),
        (b"\x00\xff\x13" * 99, "is not well-formed XML"),
        (b"<sdf>" + b"<link/>" * 300_001, "must have at most 300000; split it"),
    ],
    ids=["empty", "cut", "binary", "huge"],
)
@pytest.mark.parametrize("name", ["a.world", "a.sdf"])
def test_a_world_that_is_no_xml_is_refused_by_the_launcher(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, name: str, data: bytes, said: str
) -> None:
    monkeypatch.setattr(
        "gibson_sim.processes.node_process.subprocess.Popen", lambda *_, **__: pytest.fail("a process was started")
    )
    (tmp_path / name).write_bytes(data)
    with pytest.raises(SystemExit) as end:
        main(["run", "--scene", str(tmp_path / name)])
    error = capsys.readouterr().err
    assert (end.value.code, error.count("\n")) == (1, 1), error
    assert error.startswith(f"gibson-sim: error: {tmp_path / name}: ") and said in error


def test_a_broken_robot_file_is_refused_by_the_launcher(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "robot.yaml").write_text("urdff: robot.urdf\n")
    with pytest.raises(SystemExit) as end:
        main(["run", "--robot", str(tmp_path)])
    assert end.value.code == 1
    assert "key 'urdff' is unknown; did you mean 'urdf'?" in capsys.readouterr().err


def test_listed_names_of_tasks_baselines_and_drives_exist() -> None:
    assert tuple(TASKS) == TASK_NAMES
    known = {baseline for task in TASKS.values() for baseline in task.baselines}
    assert set(TaskConfig.__dataclass_fields__["baseline"].metadata["choices"]) == known
    for name in set(DRIVES) - {"tour", "keyboard"}:
        assert scripted_drive(name).duration > 0.0


def test_drake_directives_with_custom_tags_are_accepted(tmp_path: Path) -> None:
    directives = tmp_path / "room.dmd.yaml"
    directives.write_text("directives:\n- add_weld: {parent: world, child: a, X_PC: {rotation: !Rpy {deg: [0, 0, 90]}}}\n")
    check_names(PhysicsConfig.of(scene=str(tmp_path)))
    directives.write_text("directives: [")
    with pytest.raises(SceneError, match=r"room\.dmd\.yaml: is not YAML"):
        check_names(PhysicsConfig.of(scene=str(directives)))
