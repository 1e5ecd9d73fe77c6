"""What the launcher says once a job is ready, and while it runs."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import pytest

from gibson_sim.cli.console import Console
from gibson_sim.cli.job_status import Hints, JobStatus
from gibson_sim.processes.job_folder import LOADED, PAGE, READY, STATUS

CAMERA = {"name": "camera", "outputs": ["rgb", "depth"], "width": 640, "height": 480, "rate_hz": 30.0}
PLAYING = {"state": "playing", "real_time_factor": 0.987, "simulation_time_s": 12.345, "touches": {"robot": []}, "waits_for": ""}


def _note(folder: Path, name: str, values: Any) -> None:
    (folder / name).write_text(values if isinstance(values, str) else json.dumps(values))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Returns the folder of a job that has loaded."""
    _note(
        tmp_path,
        LOADED,
        {"scene": "flat", "robots": [{"name": "robot", "model": "gibson_bot", "drives": True}], "cameras": [CAMERA]},
    )
    return tmp_path


def test_ready_lines_name_domain_scene_robots_cameras_and_the_ways_to_drive_look_and_stop(folder: Path) -> None:
    lines = JobStatus(folder, ["physics", "render"]).ready_lines(Hints(7))
    assert lines == [
        "ready: flat in ROS domain 7; robots: robot (gibson_bot)",
        "cameras: camera 640x480 rgb+depth 30 Hz",
        "drive: `gibson-sim drive keyboard --domain-id 7` in a second terminal, or publish cmd_vel",
        "look: `gibson-sim web --domain-id 7` in a second terminal serves a page for your browser",
        "stop: Ctrl-C",
    ]


def test_ready_lines_name_the_page_that_is_served_and_what_drives(folder: Path) -> None:
    _note(folder, PAGE, "http://127.0.0.1:8080/")
    status = JobStatus(folder, ["physics", "web"])
    assert "look: http://127.0.0.1:8080/" in status.ready_lines(Hints(0))
    assert "look: http://127.0.0.1:8080/ (port 8080 is taken)" in status.ready_lines(Hints(0, taken_port=8080))
    assert any(line.startswith("drive: W A S D on the page") for line in status.ready_lines(Hints(0)))
    driven = status.ready_lines(Hints(0, "the drive tour commands the robot", "after 5 s or Ctrl-C", paused=True))
    assert driven[1:] == [
        "drive: the drive tour commands the robot",
        "look: http://127.0.0.1:8080/",
        "time: paused; `gibson-sim play` starts it",
        "stop: after 5 s or Ctrl-C",
    ]


def test_ready_lines_of_an_arm_without_a_drive_mention_no_driving(tmp_path: Path) -> None:
    _note(tmp_path, LOADED, {"scene": "flat", "robots": [{"name": "arm", "model": "panda", "drives": False}], "cameras": []})
    lines = JobStatus(tmp_path, ["physics", "render"]).ready_lines(Hints(0))
    assert [line.partition(":")[0] for line in lines] == ["ready", "cameras", "look", "stop"]


def test_line_names_what_loads_until_all_nodes_are_ready(folder: Path) -> None:
    status = JobStatus(folder, ["physics", "render"])
    assert status.line() == ""
    _note(folder, STATUS.format("render"), {"loading": "textures: 40 %"})
    assert not status.is_ready
    assert status.line() == "loading: render: textures: 40 %"


@pytest.mark.parametrize(
    ("physics", "render", "expected"),
    [
        ({}, {"images_per_s": 29.7, "skipped": 3}, "12.3 s, real-time factor 0.99, 30 images/s, 3 skipped"),
        ({}, {"images_per_s": 0.0, "skipped": 0}, "12.3 s, real-time factor 0.99, images: no subscriber"),
        (
            {},
            {"images_per_s": 0.0, "skipped": 0, "failed": 30},
            "12.3 s, real-time factor 0.99, 0 images/s, 0 skipped, 30 failed",
        ),
        ({"state": "paused"}, {"images_per_s": 1.0, "skipped": 0}, "12.3 s, paused, 1 images/s, 0 skipped"),
        ({}, {"loading": "textures: 7 %"}, "12.3 s, real-time factor 0.99, render loads: textures: 7 %"),
        (
            {"touches": {"robot": ["a", "b", "c", "d"], "other": []}, "waits_for": "follow"},
            {},
            "12.3 s, real-time factor 0.99, waits for follow, robot touches a, b, c and 1 more",
        ),
    ],
)
def test_line_reports_the_state_of_the_simulation(folder: Path, physics: Any, render: Any, expected: str) -> None:
    _note(folder, READY, "")
    _note(folder, STATUS.format("physics"), PLAYING | physics)
    _note(folder, STATUS.format("render"), render)
    assert JobStatus(folder, ["physics", "render"]).line() == expected


class _Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_lines_are_written_above_the_status_line_of_a_terminal() -> None:
    out = _Terminal()
    console = Console(out)
    console.status("1 s")
    console.write("physics  | a warning")
    console.status("2 s")
    console.status("")
    console.write("end")
    assert out.getvalue() == "\r\x1b[K1 s\r\x1b[Kphysics  | a warning\n1 s\r\x1b[K2 s\r\x1b[Kend\n"


def test_a_file_gets_whole_lines_alone() -> None:
    out = io.StringIO()
    console = Console(out)
    console.status("1 s")
    console.write("a warning")
    assert out.getvalue() == "a warning\n"


def test_a_warning_is_repeated_after_ten_seconds_at_the_earliest(monkeypatch: pytest.MonkeyPatch) -> None:
    console, now = Console(io.StringIO()), 100.0
    monkeypatch.setattr("gibson_sim.cli.console.time.monotonic", lambda: now)
    assert not console.was_written("WARN a")
    assert not console.was_written("WARN b")
    now = 109.0
    assert console.was_written("WARN a"), "of another node, too"
    now = 111.0
    assert not console.was_written("WARN a")
