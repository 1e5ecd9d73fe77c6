"""``gibson-sim demo``: the requests that it refuses, the processes that it starts, its output."""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path

import pytest

from gibson_sim.cli.commands.demo import VIEW, _plan, _report, add_parser
from gibson_sim.cli.main import main
from gibson_sim.scenes.load_views import read_views
from gibson_sim.tasks.ground import ground_of
from gibson_sim.tasks.kinds.open_door import OpenDoor, episode_door


def _args(*words: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    add_parser(parser.add_subparsers())
    return parser.parse_args(["demo", "open-door", *words])


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["fly"], "demo 'fly' is unknown; known: open-door"),
        (["open-door", "--image-rate", "0"], "--image-rate is 0 Hz, must be 0.1 to 60"),
        (["open-door", "--columns", "0"], "--columns is 0, must be 1 to 100"),
        (["open-door", "--seed", "-1"], "--seed is -1, must be 0 or more"),
        (["open-door", "--size", "big"], "'view_size' is 'big'"),
        (["open-door", "--scene", "nowhere"], "nowhere"),
        (["open-door", "--scene", "arena", "--robot", "gibson_bot"], "has no arm with a gripper"),
        (["open-door", "--scene", "flat"], "no door that a robot has the room to pull open"),
    ],
)
def test_impossible_options_are_refused_before_anything_starts(
    words: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as end:
        main(["demo", *words, "--out", str(tmp_path / "out")])
    assert end.value.code == 1
    assert said in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_an_existing_bag_is_not_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "bag").mkdir()
    with pytest.raises(SystemExit) as end:
        main(["demo", "open-door", "--scene", "arena", "--out", str(tmp_path)])
    assert end.value.code == 1 and "it contains a bag already" in capsys.readouterr().err


def test_the_task_node_and_the_render_node_take_part_in_lockstep_and_both_views_are_recorded(tmp_path: Path) -> None:
    ground = ground_of("arena", "arm_bot")
    episode = OpenDoor().generate(3, ground)
    args = _args("--scene", "arena", "--seed", "3", "--out", str(tmp_path), "--size", "320x200", "--image-rate", "5")
    job = _plan(args, tmp_path, episode, episode_door(episode), "head_camera")
    assert list(job.configs) == ["task", "record", "render", "physics"]
    physics, task, record = job.configs["physics"], job.configs["task"], job.configs["record"]
    assert physics.sync.lockstep and physics.sync.participants == "task; render; record" and physics.time.rate == 0.0
    assert [float(part) for part in physics.world.start.split(",")][:2] == pytest.approx(episode.start.position[:2])
    assert (task.seed, task.baseline, task.scene) == (3, "scripted", "arena")
    assert {"head_camera/image_raw", f"{VIEW}/image_raw"} <= set(record.wanted_topics())
    (view,) = read_views(physics.cameras.views)
    assert (view.camera.name, view.camera.width, view.camera.height, view.camera.rate_hz) == (VIEW, 320, 200, 5.0)


def test_the_report_states_the_door_width_and_whether_the_robot_went_through(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    args = _args("--out", str(tmp_path))
    measured = {"begin_s": 1.0, "open_after_s": 17.25, "end_s": 41.0, "widest_deg": 91.6, "end_deg": 88.2}
    result = {"success": True, "time": 40.0, "path_length": 6.149, "collisions": 0}
    assert _report(args, result, measured) == 0
    said = capsys.readouterr().out
    assert (
        "success after 40.0 s; door 60 degrees after 17.2 s, opened by at most 92 degrees, 88 at the end; 6.15 m driven" in said
    )
    assert _report(args, {**result, "success": False}, {**measured, "open_after_s": math.nan}) == 1
    assert "failure" in capsys.readouterr().out
    assert json.loads((tmp_path / "result.json").read_text())["open_after_s"] is None
