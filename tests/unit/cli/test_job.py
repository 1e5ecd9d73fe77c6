"""The order in which the nodes of a job start, and the output if one fails, with fake nodes."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any, ClassVar

import pytest

from gibson_sim.cli import job as job_module
from gibson_sim.cli.commands import run
from gibson_sim.cli.job import Job, JobRun
from gibson_sim.processes.job_folder import LOADED

MEASURED = {"scene": "flat", "wall_time_s": 1.0, "real_time_factor": 1.0, "commands": 0, "refused_commands": 0}


class FakeNode:
    """A node that ends at once with a code, or reports that it has loaded."""

    started: tuple[str, ...] = ()
    stopped: tuple[str, ...] = ()
    codes: ClassVar[dict[str, int]] = {}
    cameras = ""
    folder = Path()

    def __init__(self, name: str, *_: Any, silent: bool = False, **__: Any) -> None:
        FakeNode.started += (name,)
        self.name, self.silent = name, silent
        if name == "physics" and name not in self.codes:
            cameras = [{"name": camera} for camera in self.cameras.split()]
            (self.folder / LOADED).write_text(json.dumps({"scene": "flat", "robots": [], "cameras": cameras}))

    def poll(self) -> int | None:
        return self.codes.get(self.name)

    def print_held(self) -> None:
        self.silent = False

    def reason(self) -> str:
        return f"{self.name} refuses"

    def print_error(self) -> None:
        pass

    def stop(self, **_: Any) -> int:
        FakeNode.stopped += (self.name,)
        return 0


def _run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *options: str, cameras: str = "camera", **codes: int) -> int:
    parser = argparse.ArgumentParser()
    run.add_parser(parser.add_subparsers())
    args = parser.parse_args(["run", "--scene", "flat", "--record", str(tmp_path / "bag"), "--reserve-mb", "1", *options])
    job: Job = run._plan(args, tmp_path)
    FakeNode.started, FakeNode.stopped, FakeNode.codes, FakeNode.cameras, FakeNode.folder = (), (), codes, cameras, tmp_path
    monkeypatch.setattr(job_module, "NodeProcess", FakeNode)
    return JobRun(job, {}).run()


def test_refused_scene_starts_no_recording_and_prints_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _run(tmp_path, monkeypatch, physics=1) == 1
    assert FakeNode.started == ("physics", "render")
    assert capsys.readouterr().err == "error: physics refuses\n"


def test_refused_device_starts_no_recording_and_prints_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(JobRun, "_accept", lambda *_: True)  # the device is opened while the scene is read
    assert _run(tmp_path, monkeypatch, render=1) == 1
    assert FakeNode.started == ("physics", "render")
    assert capsys.readouterr().err == "error: render refuses\n"


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--cameras", "camra"), "setting 'cameras' has camera 'camra'; did you mean 'camera'? the scene has: camera, view_top"),
        (("--register-depth", "depth=camera"), "setting 'register_depth' has camera 'depth'; the scene has: camera, view_top"),
    ],
)
def test_unknown_camera_is_an_error_that_lists_the_cameras(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], options: tuple[str, ...], said: str
) -> None:
    assert _run(tmp_path, monkeypatch, *options, cameras="camera\nview_top") == 1
    assert "record" not in FakeNode.started
    assert capsys.readouterr().err == f"error: {said}\n"


def test_recording_starts_once_the_scene_is_accepted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert _run(tmp_path, monkeypatch, record=1) == 1
    assert FakeNode.started == ("physics", "render", "record")


def test_time_ends_before_the_recorder_does(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert _run(tmp_path, monkeypatch, "--drive", "square", drive=0) == 0
    assert FakeNode.stopped == ("physics", "render", "record")


def test_bag_of_a_killed_recorder_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stop(node: FakeNode, **_: Any) -> int:
        if node.name == "render":
            (tmp_path / "bag").mkdir()
        return 0

    monkeypatch.setattr(FakeNode, "stop", stop)
    _run(tmp_path, monkeypatch, "--drive", "square", drive=0)
    assert (tmp_path / "bag").is_dir(), "it left no summary of its recording"


@pytest.mark.parametrize(("simulated", "code"), [(0.0, 130), (1.5, 0)])
def test_ctrl_c_before_time_begins_is_an_interruption_and_leaves_no_empty_bag(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, simulated: float, code: int, capsys: pytest.CaptureFixture[str]
) -> None:
    class StopAfterRecorder:
        count = 0

        def close(self) -> None:
            pass

    request = StopAfterRecorder()

    def stop(node: FakeNode, **_: Any) -> int:
        if node.name == "physics":
            (tmp_path / "physics.json").write_text(json.dumps({**MEASURED, "simulation_time_s": simulated}))
        if node.name == "record":
            (tmp_path / "bag").mkdir()
            (tmp_path / "record.json").write_text(json.dumps({"messages": {"clock": round(simulated)}, "lost": {}, "error": ""}))
        return 0

    def poll(node: FakeNode) -> None:
        request.count += node.name == "record"

    monkeypatch.setattr(job_module, "StopRequest", lambda: request)
    monkeypatch.setattr(FakeNode, "stop", stop)
    monkeypatch.setattr(FakeNode, "poll", poll)
    assert _run(tmp_path, monkeypatch) == code
    assert (tmp_path / "bag").exists() == bool(simulated)
    assert "ending before time has started: the nodes are stopping" in capsys.readouterr().err


def test_full_disk_is_refused_before_anything_starts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gibson_sim.bags.folders.shutil.disk_usage", lambda _: argparse.Namespace(free=10 * 2**20))
    with pytest.raises(Exception, match="has 10 MiB left, recording needs more than 132 MiB"):
        _run(tmp_path, monkeypatch, "--reserve-mb", "130")


def test_unwritable_summary_prevents_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    made: list[Path] = []
    monkeypatch.setattr("gibson_sim.bags.video.write_pictures", lambda bag, video: made.append(video) or [video])
    (tmp_path / "record.json").write_text('{"messages": {"/a": 1}, "lost": {}, "error": ""}')
    (tmp_path / "file").touch()
    files = ("--summary", str(tmp_path / "file/a.json"), "--video", str(tmp_path / "a.mp4"))
    assert _run(tmp_path, monkeypatch, "--drive", "square", *files, drive=0) == 1
    assert made == [tmp_path / "a.mp4"]
    assert "error: cannot write" in capsys.readouterr().err
