"""The nodes, fed by hand: what a robot does when images, time or the dead man's switch are not as they should be."""

from __future__ import annotations

import importlib
import json
import math
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from support.simulation import require

require("rclpy", "sensor_msgs", "lifecycle_msgs")

from geometry_msgs.msg import Twist, Vector3  # noqa: E402
from lifecycle_msgs.msg import Transition  # noqa: E402
from lifecycle_msgs.srv import ChangeState  # noqa: E402
from nav_msgs.msg import Odometry  # noqa: E402
from rclpy.lifecycle import TransitionCallbackReturn  # noqa: E402
from rclpy.node import Node  # noqa: E402
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, Joy  # noqa: E402
from std_msgs.msg import Bool, String  # noqa: E402

from gibson_path_following.errors import ModelError, PathFolderError, PathFollowingError, SettingError, ViewError  # noqa: E402
from gibson_path_following.nodes import camera_input, conversions, path_policy, running  # noqa: E402
from gibson_path_following.nodes.camera_faults import CameraFaultsNode  # noqa: E402
from gibson_path_following.nodes.image_watch import ImageWatch  # noqa: E402
from gibson_path_following.nodes.path_evaluator import PathEvaluatorNode  # noqa: E402
from gibson_path_following.nodes.path_localiser import PathLocaliserNode  # noqa: E402
from gibson_path_following.nodes.path_policy import PathPolicyNode  # noqa: E402
from gibson_path_following.nodes.path_recorder import PathRecorderNode  # noqa: E402
from gibson_path_following.nodes.running import run_node  # noqa: E402
from gibson_path_following.options import CameraOptions, Options  # noqa: E402
from gibson_path_following.paths import path_folder  # noqa: E402
from gibson_path_following.paths.path_folder import load_path, save_path  # noqa: E402
from gibson_path_following.policies.backends import make_policy  # noqa: E402
from gibson_path_following.types import PathNode, RecordedPath, Velocity  # noqa: E402
from support.fed_node import FedNode  # noqa: E402

Feed = Callable[..., FedNode]
pytestmark = pytest.mark.ros
NS = 1_000_000_000
TICK = NS // 5
WIDTH, HEIGHT = 96, 64
RNG = np.random.default_rng(5)
WALL = RNG.integers(0, 255, (HEIGHT // 8, 40 * WIDTH // 8, 3)).repeat(8, 0).repeat(8, 1).astype(np.uint8)
"""A wall of coloured squares, along which the camera looks farther and farther to the left."""


def _image(node: int) -> np.ndarray:
    return np.ascontiguousarray(WALL[:, node * WIDTH : (node + 1) * WIDTH])


def _path() -> RecordedPath:
    forward = ((0, Velocity(0.4, 0.0)),)
    nodes = tuple(PathNode((_image(k),), k * NS // 2, 0.2 * k, forward, (0.2 * k, 0.0, 0.0)) for k in range(12))
    return RecordedPath("pinhole", 1.4, nodes)


def _image_msg(node: int, stamp_ns: int) -> Image:
    msg = Image(height=HEIGHT, width=WIDTH, encoding="rgb8", step=3 * WIDTH, data=_image(node).tobytes())
    msg.header.stamp = conversions.time_msg(stamp_ns)
    return msg


class Driven:
    """The policy on a path."""

    def __init__(self, feed: Feed, folder: Path, **parameters: Any) -> None:
        self.fed = feed(PathPolicyNode, path=str(folder), **{"use_camera_info": False, "backend": "teach_repeat", **parameters})
        self.lines = self.fed.lines

    @property
    def speed(self) -> float:
        """The newest commanded speed, m/s."""
        return float(self.fed.sent("cmd_vel")[-1].linear.x)

    @property
    def speeds(self) -> set[float]:
        return {msg.linear.x for msg in self.fed.sent("cmd_vel")}

    @property
    def states(self) -> list[str]:
        return [msg.data for msg in self.fed.sent("path/state")]

    @property
    def state(self) -> str:
        return self.states[-1]

    @property
    def index(self) -> float:
        """The place of the newest view, nodes."""
        return float(self.fed.sent("path/index")[-1].data)

    def see(self, node: int, stamp_ns: int, now_ns: int | None = None) -> None:
        self.fed.now_ns = stamp_ns if now_ns is None else now_ns
        self.fed.receive("camera/image_raw", _image_msg(node, stamp_ns))

    def wait(self, ns: int) -> None:
        """Lets time pass until the watchdog works, ns."""
        self.fed.now_ns += ns
        self.fed.expire_timers(0.1)

    def begin(self) -> int:
        """Sees the first node until it drives; returns the time."""
        for k in range(1, 4):
            self.see(0, k * TICK)
        return 3 * TICK


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    save_path(_path(), tmp_path / "path")
    return tmp_path / "path"


def test_robot_drives_once_it_is_localised_and_stops_without_images(feed: Feed, folder: Path) -> None:
    driven = Driven(feed, folder)
    driven.begin()
    assert driven.fed.sent("cmd_vel")[0].linear.x == 0.0 and driven.speed > 0.2 and driven.state == "following"
    driven.wait(NS // 2)
    assert driven.speed > 0.2, "images are half a second old, which is allowed"
    driven.wait(1)
    assert driven.speed == 0.0 and driven.state == "stale"


@pytest.fixture
def wall(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Wall time of the camera input, ns, as attribute ``ns``."""
    wall = SimpleNamespace(ns=NS)
    monkeypatch.setattr(camera_input.time, "monotonic_ns", lambda: wall.ns)
    return wall


@pytest.mark.parametrize(
    ("ahead_s", "line"),
    [
        (
            -30,
            "30.0 s behind this node's clock, at most 0.5 s are allowed; set use_sim_time as the node of the camera has it, or sync",
        ),
        (3600, "3600.0 s ahead of this node's clock, at most 0.5 s are allowed; set use_sim_time as"),
        (
            -1,
            "1.0 s behind this node's clock, at most 0.5 s are allowed; camera, network or this machine is too slow, or the camera's",
        ),
    ],
)
def test_images_of_another_clock_never_drive_the_robot_and_are_reported(
    feed: Feed, folder: Path, wall: Any, ahead_s: int, line: str
) -> None:
    driven = Driven(feed, folder)
    for k in range(1, 20):
        wall.ns += TICK
        driven.see(0, 4000 * NS + k * TICK + ahead_s * NS, 4000 * NS + k * TICK)
        driven.wait(0)
    assert driven.speeds == {0.0} and driven.state == "waiting"
    assert driven.lines and all(f"image stamps are {line}" in each for each in driven.lines)


def test_one_image_from_the_future_or_the_past_changes_nothing(feed: Feed, folder: Path) -> None:
    driven = Driven(feed, folder)
    driven.begin()
    for k in range(4, 24):
        driven.see(int(0.4 * (k - 3)), k * TICK)
    for stamp in (23 * TICK + 20 * NS, 0):
        driven.see(0, stamp, 23 * TICK)
    driven.see(8, 24 * TICK)
    assert driven.index > 5.0 and driven.speed > 0.2 and driven.lines == []


@pytest.fixture
def policy(monkeypatch: pytest.MonkeyPatch) -> Callable[[], Any]:
    """Returns the policy of the node that has been made, to disturb it."""
    made: list[Any] = []

    def make(*args: Any) -> Any:
        made.append(make_policy(*args))
        return made[-1]

    monkeypatch.setattr(path_policy, "make_policy", make)
    return lambda: made[-1][0]


def test_a_policy_that_is_too_slow_for_its_images_does_not_drive(feed: Feed, folder: Path, policy: Callable[[], Any]) -> None:
    driven = Driven(feed, folder)
    now = driven.begin()
    act = policy().act

    def slow(*args: Any) -> Velocity:
        driven.fed.now_ns += NS
        return act(*args)

    policy().act = slow
    driven.see(0, now + TICK)
    assert driven.speed == 0.0 and driven.state == "stale"
    assert driven.lines == [
        "teach_repeat needed 1.0 s for a view, after which it was 1.0 s old: this machine is too slow for stale_after 0.5 s"
    ]


def test_states_from_the_start_on_come_in_their_order_and_none_alarms(feed: Feed, folder: Path) -> None:
    driven = Driven(feed, folder)
    driven.wait(0)
    driven.see(0, TICK)
    driven.wait(0)
    driven.see(0, 2 * TICK)
    assert driven.states == ["waiting", "localising", "following"]


def test_a_path_that_cannot_be_read_is_an_error_and_no_state(
    feed: Feed, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(PathFolderError, match="cannot read"):
        Driven(feed, tmp_path / "none")
    assert "inactive" not in capfd.readouterr().err


def test_robot_stands_while_the_policy_fails_and_goes_on_afterwards(feed: Feed, folder: Path, policy: Callable[[], Any]) -> None:
    driven = Driven(feed, folder)
    now = driven.begin()
    act = policy().act

    def fails(*args: Any) -> Velocity:
        raise ModelError("net.onnx: its output holds a NaN or an infinity; export it anew")

    policy().act = fails
    driven.see(0, now + TICK)
    assert driven.speed == 0.0 and driven.state == "failed"
    driven.wait(0)
    assert driven.speed == 0.0 and driven.state == "failed", "what was commanded before does not go on"
    policy().act = act
    driven.see(0, now + 2 * TICK)
    driven.see(0, now + 3 * TICK)
    assert driven.speed > 0.2 and driven.state == "following"


def test_robot_drives_only_while_the_dead_mans_switch_is_held(feed: Feed, folder: Path) -> None:
    driven = Driven(feed, folder, deadman_button=1)
    now = driven.begin()
    assert driven.speeds == {0.0} and driven.state == "held"
    driven.fed.receive("joy", Joy(buttons=[0, 1]))
    driven.see(0, now + TICK)
    assert driven.speed > 0.2
    driven.fed.receive("joy", Joy(buttons=[1, 0]))
    assert driven.speed == 0.0, "at once"
    driven.fed.receive("joy", Joy(buttons=[0, 1]))
    driven.wait(2 * NS)
    assert driven.speed == 0.0, "joy is silent"


def test_robot_stands_until_a_lifecycle_manager_activates_the_node(feed: Feed, folder: Path) -> None:
    driven = Driven(feed, folder, autostart=False)
    assert driven.fed.subscription("camera/image_raw") is None and driven.state == "inactive"
    driven.fed.node.trigger_configure()
    driven.fed.node.trigger_activate()
    driven.begin()
    assert driven.speed > 0.2
    driven.fed.node.trigger_deactivate()
    assert driven.speed == 0.0 and driven.fed.subscription("camera/image_raw") is None and driven.state == "inactive"
    driven.fed.node.trigger_cleanup()


def test_a_transition_that_is_not_possible_is_refused_and_the_robot_drives_on(feed: Feed, folder: Path) -> None:
    driven = Driven(feed, folder)
    now = driven.begin()
    request = ChangeState.Request(transition=Transition(id=Transition.TRANSITION_CONFIGURE))
    response = driven.fed.call("path_policy/change_state", request)
    assert not response.success
    assert driven.lines == ["transition 'configure' is not possible while path_policy is active; possible: deactivate, shutdown"]
    driven.see(0, now + TICK)
    assert driven.speed > 0.2
    request.transition.id = Transition.TRANSITION_DEACTIVATE
    assert driven.fed.call("path_policy/change_state", request).success
    assert driven.speed == 0.0


def test_a_path_that_cannot_be_read_fails_the_transition(feed: Feed, tmp_path: Path) -> None:
    driven = Driven(feed, tmp_path / "none", autostart=False)
    assert driven.fed.node.trigger_configure().name == "FAILURE"


def test_stamps_that_go_back_begin_the_path_again(feed: Feed, folder: Path) -> None:
    driven = Driven(feed, folder)
    driven.begin()
    for k in range(4, 24):
        driven.see(int(0.4 * (k - 3)), k * TICK)  # 0.4 m/s, as commanded
    assert driven.index > 5.0
    driven.see(0, 1)
    assert driven.index < 1.0


class Recording:
    """The recorder, which gets a node for each image."""

    def __init__(self, feed: Feed, folder: Path, **parameters: Any) -> None:
        values = {
            "use_camera_info": False,
            "camera_hfov_deg": 80.0,
            "use_odometry": False,
            "interval": 0.2,
            "autostart": True,
            **parameters,
        }
        self.fed = feed(PathRecorderNode, folder=str(folder), **values)
        # As messages that came before the recording ended.
        self._on_image = self.fed.subscription(values.get("image_topics", ["camera/image_raw"])[0]).callback

    def see(self, node: int, stamp_ns: int) -> None:
        self._on_image(_image_msg(node, stamp_ns))

    def stop(self) -> None:
        self.fed.node.stop()


def test_a_path_is_written_when_stamps_go_back_and_the_next_one_does_not_replace_it(feed: Feed, tmp_path: Path) -> None:
    recording = Recording(feed, tmp_path / "new")
    for k in range(8):
        recording.see(k, 10 * NS + k * TICK)
    recording.see(0, NS)
    recording.see(1, 2 * NS)
    assert len(load_path(tmp_path / "new").nodes) == 8
    answer = recording.fed.call("path_recorder/start")
    assert not answer.success
    assert answer.message == f"cannot write {tmp_path / 'new'}: it exists; give a new folder, or set replace to true"
    recording.stop()
    assert len(load_path(tmp_path / "new").nodes) == 8


def test_a_recording_goes_on_if_stamps_go_back_before_the_robot_drives(feed: Feed, tmp_path: Path) -> None:
    recording = Recording(feed, tmp_path / "new")
    recording.see(0, 10 * NS)
    for k in range(4):
        recording.see(k, NS + k * TICK)
    recording.stop()
    assert [node.stamp_ns for node in load_path(tmp_path / "new").nodes] == [NS + k * TICK for k in range(4)]


def test_a_folder_that_exists_is_refused_before_anything_is_recorded(feed: Feed, folder: Path) -> None:
    with pytest.raises(PathFolderError, match="it exists; give a new folder, or set replace to true"):
        Recording(feed, folder)
    Recording(feed, folder, replace=True)


def test_a_folder_that_is_being_recorded_is_refused_to_a_second_recorder_until_it_is_written(feed: Feed, tmp_path: Path) -> None:
    first = Recording(feed, tmp_path / "new", replace=True)
    with pytest.raises(PathFolderError, match="another recorder has this folder; end that one, or give another folder"):
        Recording(feed, tmp_path / "new", replace=True)
    second = Recording(feed, tmp_path / "other", replace=True)
    for k in range(4):
        first.see(k, NS + k * TICK)
    assert first.fed.call("path_recorder/stop").success
    third = Recording(feed, tmp_path / "new", replace=True)
    third.see(0, NS)
    for recording in (second, third):
        with pytest.raises(PathFollowingError, match="no path is written"):
            recording.stop()
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["new"] and len(load_path(tmp_path / "new").nodes) == 4
    for recording in (first, second, third):
        recording.fed.node.destroy_node()


def test_a_single_image_of_another_time_does_not_end_the_recording(feed: Feed, tmp_path: Path) -> None:
    recording = Recording(feed, tmp_path / "new")
    for k, stamp_ns in enumerate(
        (10 * NS, 10 * NS + TICK, 20 * NS, 10 * NS + 2 * TICK, 0, 10 * NS + 3 * TICK, 10 * NS + 4 * TICK)
    ):
        recording.see(k, stamp_ns)
    recording.stop()
    assert [node.stamp_ns for node in load_path(tmp_path / "new").nodes] == [10 * NS + k * TICK for k in range(5)]
    assert recording.fed.lines == [
        "images: one stamp was 9.6 s ahead of the next one and is left out; correct the driver",
        "images: one stamp was 10.6 s behind the next one and is left out; correct the driver",
    ]


def test_a_path_that_cannot_be_written_is_kept_and_a_second_stop_writes_it(feed: Feed, tmp_path: Path) -> None:
    recording = Recording(feed, tmp_path / "new")
    for k in range(4):
        recording.see(k, NS + k * TICK)
    (tmp_path / "new").mkdir()
    kept = "the path is kept: call path_recorder/stop to try again, or end the node, which writes new-2"
    answer = recording.fed.call("path_recorder/stop")
    assert not answer.success
    assert answer.message == f"cannot write {tmp_path / 'new'}: it exists; give a new folder; {kept}"
    assert recording.fed.call("path_recorder/start").message == f"the last path is not written yet; {kept}"
    (tmp_path / "new").rmdir()
    answer = recording.fed.call("path_recorder/stop")
    assert answer.success and answer.message == f"wrote {tmp_path / 'new'}: 4 nodes without poses, 0.00 m"
    assert len(load_path(tmp_path / "new").nodes) == 4
    assert not recording.fed.call("path_recorder/stop").success
    recording.stop()


def test_a_path_that_cannot_be_written_at_the_end_of_the_node_goes_to_a_folder_beside(feed: Feed, tmp_path: Path) -> None:
    recording = Recording(feed, tmp_path / "new")
    for k in range(4):
        recording.see(k, NS + k * TICK)
    for name in ("new", "new-2"):
        (tmp_path / name).mkdir()
    with pytest.raises(PathFollowingError) as caught:
        recording.stop()
    assert str(caught.value) == (
        f"cannot write {tmp_path / 'new'}: it exists; give a new folder; wrote {tmp_path / 'new-3'}: 4 nodes without poses, 0.00 m"
    )
    assert len(load_path(tmp_path / "new-3").nodes) == 4
    recording.stop()


def test_a_path_that_cannot_be_written_beside_its_folder_goes_to_that_of_temporary_files(
    feed: Feed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "disk").mkdir()
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    recording = Recording(feed, tmp_path / "disk" / "new")
    for k in range(4):
        recording.see(k, NS + k * TICK)
    shutil.rmtree(tmp_path / "disk")
    (tmp_path / "disk").write_text("a file now")
    with pytest.raises(PathFollowingError, match=r"disk is not a folder; give another folder; wrote .*temporary/new-2: 4 nodes"):
        recording.stop()
    assert len(load_path(tmp_path / "temporary" / "new-2").nodes) == 4


def test_a_path_that_is_as_long_as_can_be_read_is_written(feed: Feed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(path_folder, "MAX_PIXELS", 3 * WIDTH * HEIGHT)
    recording = Recording(feed, tmp_path / "new")
    for k in range(5):
        recording.see(k, NS + k * TICK)
    assert len(load_path(tmp_path / "new").nodes) == 3 and recording.fed.subscription("camera/image_raw") is None
    recording.stop()


def test_a_lens_that_sees_behind_itself_is_refused_at_the_first_image_of_a_pinhole_path(feed: Feed, tmp_path: Path) -> None:
    recording = Recording(feed, tmp_path / "new", use_camera_info=True)
    # Equidistant, 15 pixels a radian: the 96 pixels would be 366 degrees, of which 219.75 are searched.
    info = CameraInfo(width=WIDTH, height=HEIGHT, distortion_model="equidistant", d=[0.0] * 4)
    info.k = [15.0, 0.0, 47.5, 0.0, 15.0, 31.5, 0.0, 0.0, 1.0]
    recording.fed.receive("camera/camera_info", info)
    recording.see(0, NS)
    assert recording.fed.sent("path_recorder/nodes") == []
    line = "the camera sees 220 degrees, a pinhole camera of a path at most 179; set hfov_deg, to 120 for example"
    with pytest.raises(PathFollowingError, match=f"no path is written: no image could be used: camera/image_raw: {line}"):
        recording.stop()


class Localised:
    """The localiser on a path."""

    def __init__(self, feed: Feed, folder: Path) -> None:
        self.fed = feed(PathLocaliserNode, path=str(folder), use_camera_info=False)

    @property
    def is_lost(self) -> list[bool]:
        """What is published with each view."""
        return [msg.data for msg in self.fed.sent("path/lost")]

    @property
    def indices(self) -> list[float]:
        return [msg.data for msg in self.fed.sent("path/index")]

    def see(self, node: int, stamp_ns: int) -> None:
        self.fed.receive("camera/image_raw", _image_msg(node, stamp_ns))


@pytest.mark.parametrize(("publishers", "moved"), [(0, range(1, 10)), (1, 9 * [0.0])])
def test_a_robot_that_is_pushed_is_localised_by_its_images_alone_once_no_node_commands_it(
    feed: Feed, folder: Path, monkeypatch: pytest.MonkeyPatch, publishers: int, moved: Sequence[float]
) -> None:
    localised = Localised(feed, folder)
    # Nodes of other tests may just be ending.
    monkeypatch.setattr(localised.fed.node, "count_publishers", lambda topic: publishers if topic == "/cmd_vel" else 0)
    localised.fed.receive("cmd_vel", Twist())
    for k in range(10):
        localised.see(k, (k + 1) * TICK)
    assert localised.is_lost == [True] + 9 * [False]
    assert localised.indices[1:] == pytest.approx(moved, abs=0.5)


@pytest.mark.parametrize("wrong_ns", [0, 50 * NS, 150 * NS])
def test_one_image_of_another_time_does_not_reset_the_localiser_and_is_reported(feed: Feed, folder: Path, wrong_ns: int) -> None:
    localised = Localised(feed, folder)
    for k in range(5):
        localised.see(k, 100 * NS + k * TICK)
    localised.see(0, wrong_ns)
    for k in range(5, 8):
        localised.see(k, 100 * NS + k * TICK)
    assert localised.is_lost == [True] + 7 * [False]
    assert localised.indices[-1] == pytest.approx(7.0, abs=0.5)
    assert len(localised.fed.lines) == 1 and localised.fed.lines[0].startswith("images: one stamp was ")


def test_two_images_of_an_earlier_time_reset_the_localiser(feed: Feed, folder: Path) -> None:
    localised = Localised(feed, folder)
    for k in range(8):
        localised.see(k, 100 * NS + k * TICK)
    localised.see(0, NS)  # a bag that plays again
    assert len(localised.is_lost) == 8
    localised.see(0, NS + TICK)
    localised.see(0, NS + 2 * TICK)
    assert localised.is_lost[8:] == [True, False, False]
    assert localised.indices[-1] == pytest.approx(0.0, abs=0.5)
    assert localised.fed.lines == ["stamps have gone back: localising anew"]


def _info() -> CameraInfo:
    info = CameraInfo(width=WIDTH, height=HEIGHT, distortion_model="plumb_bob", d=[0.0] * 5)
    focal = WIDTH / 2 / np.tan(0.7)
    info.k = [focal, 0.0, (WIDTH - 1) / 2, 0.0, focal, (HEIGHT - 1) / 2, 0.0, 0.0, 1.0]
    return info


def test_images_wait_for_their_camera_info(feed: Feed, folder: Path, wall: Any) -> None:
    driven = Driven(feed, folder, use_camera_info=True)
    driven.see(0, TICK)
    assert driven.fed.sent("path/index") == [] and driven.lines == []
    wall.ns += 2 * NS
    driven.see(0, TICK)  # stamps that stand still do not silence the line
    assert driven.lines == ["no camera_info beside camera/image_raw yet; publish it, or set use_camera_info to false"]
    driven.fed.receive("camera/camera_info", _info())
    driven.see(0, 2 * TICK)
    assert driven.fed.sent("path/index") != []


def test_an_image_whose_camera_info_arrives_after_it_is_used_unless_it_is_too_old_by_then(
    feed: Feed, folder: Path, tmp_path: Path
) -> None:
    recording = Recording(feed, tmp_path / "new", use_camera_info=True, camera_hfov_deg=0.0)
    recording.see(0, NS)
    recording.fed.receive("camera/camera_info", _info())
    recording.see(1, NS + TICK)
    recording.fed.receive("camera/camera_info", _info())
    recording.stop()
    assert [node.stamp_ns for node in load_path(tmp_path / "new").nodes] == [NS, NS + TICK]
    driven = Driven(feed, folder, use_camera_info=True)
    driven.see(0, TICK)
    driven.fed.now_ns += NS
    driven.fed.receive("camera/camera_info", _info())
    assert driven.fed.sent("path/index") == []


def test_a_camera_info_without_calibration_or_with_an_impossible_one_stops_the_robot(feed: Feed, folder: Path) -> None:
    driven = Driven(feed, folder, use_camera_info=True)
    driven.fed.receive("camera/camera_info", _info())
    now = driven.begin()
    assert driven.speed > 0.2
    for k, (value, line) in enumerate(
        [
            (
                0.0,
                "the field of view is not known: the camera is not calibrated; set camera_hfov_deg, or publish a calibrated camera_info; or",
            ),
            (float("nan"), "camera_info: k is (nan, nan, "),
        ]
    ):
        info = _info()
        info.k = [value] * 9
        driven.fed.receive("camera/camera_info", info)
        driven.see(0, now + (1 + 4 * k) * TICK)
        driven.wait(3 * TICK)
        assert driven.speed == 0.0 and driven.lines.pop().startswith(f"camera/image_raw: {line}")
        driven.fed.receive("camera/camera_info", _info())
        driven.see(0, driven.fed.now_ns)
        assert driven.speed > 0.2


class PairNode(Node):
    """The input of a fisheye pair that is calibrated, and the stamps of its views."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("pair", **kwargs)
        self.stamps: list[int] = []
        options = CameraOptions(image_topics=("front/image_raw", "back/image_raw"), use_camera_info=False, rate_hz=5.0)
        camera_input.CameraInput(
            self, options, "fisheye_pair", (32, 32), 3.0, lambda stamp, _: self.stamps.append(stamp), lambda: None
        )


class Pairs:
    """What cameras send to ``PairNode``, and the stamps of its views."""

    def __init__(self, feed: Feed) -> None:
        self.fed = feed(PairNode)
        self.stamps, self.lines = self.fed.node.stamps, self.fed.lines

    def see(self, name: str, stamp_ns: int) -> None:
        msg = Image(height=32, width=32, encoding="mono8", step=32, data=bytes(32 * 32))
        msg.header.stamp = conversions.time_msg(stamp_ns)
        self.fed.now_ns = stamp_ns
        self.fed.receive(f"{name}/image_raw", msg)


def test_one_lost_image_of_a_pair_does_not_end_the_views(feed: Feed) -> None:
    pairs, step = Pairs(feed), NS // 20
    for k in range(40):
        pairs.see("front", k * step)
        if k != 8:
            pairs.see("back", k * step)
    # At most 5 a second of 20; the view of 8 is not complete.
    assert [stamp // step for stamp in pairs.stamps] == [0, 4, 9, 13, 17, 21, 25, 29, 33, 37]


def test_a_pair_that_is_never_taken_at_the_same_time_is_one_line(feed: Feed, wall: Any) -> None:
    pairs = Pairs(feed)
    for _ in range(30):
        wall.ns += NS // 10
        pairs.see("front", wall.ns)
        pairs.see("back", wall.ns + NS // 20)
    assert pairs.stamps == []
    line = "the images of front and back are 50 ms apart by their stamps, sync_tolerance allows 20 ms; trigger the cameras at the same"
    assert pairs.lines and all(each.startswith(line) for each in pairs.lines)


def test_a_camera_of_a_pair_that_died_is_one_line(feed: Feed, wall: Any) -> None:
    pairs = Pairs(feed)
    wall.ns += 10 * NS  # the cameras start later
    for k in range(40):
        wall.ns += NS // 10
        pairs.see("front", wall.ns)
        if k < 10:
            pairs.see("back", wall.ns)
    assert len(pairs.stamps) == 5  # of 10 in a second
    assert pairs.lines and set(pairs.lines) == {"images come from front, but not from back; do all cameras run?"}


def test_a_recording_of_one_camera_of_a_pair_says_which_one_is_missing(feed: Feed, tmp_path: Path, wall: Any) -> None:
    topics = ["front/image_raw", "back/image_raw"]
    recording = Recording(feed, tmp_path / "new", camera="fisheye_pair", image_topics=topics, hfov_deg=180.0)
    for _ in range(30):
        wall.ns += NS // 10
        recording.see(0, wall.ns)
    with pytest.raises(
        PathFollowingError, match="no image could be used: images come from front, but not from back; do all cameras run"
    ):
        recording.stop()


class WatchNode(Node):
    def __init__(self, **kwargs: Any) -> None:
        super().__init__("watch", namespace="robot", **kwargs)


def test_topics_without_images_and_stamps_that_stand_still_are_one_line(feed: Feed) -> None:
    fed = feed(WatchNode)
    watch = ImageWatch(fed.node, {"front/image_raw": Image, "back/image_raw": Image}, "parameter image_topics")
    fed.expire_timers(5.0)
    assert len(fed.lines) == 2
    assert (
        fed.lines[1] == "no image has come from /robot/back/image_raw; does the camera run, and is parameter image_topics right?"
    )
    for _ in range(9):
        watch.note("front/image_raw", 0)
    fed.lines.clear()
    fed.expire_timers(5.0)
    assert len(fed.lines) == 1 and "back" in fed.lines[0]
    watch.note("front/image_raw", 0)
    assert fed.lines[1] == "the last 10 images from front/image_raw all have the stamp 0.000 s; correct the camera's driver"
    watch.close()
    watch.close()


@pytest.mark.parametrize(
    ("values", "part"),
    [
        ({"rate_hz": -1.0}, "rate_hz"),
        ({"backend": "magic"}, "backend is 'magic'"),
        ({"max_linear": "fast"}, "max_linear is 'fast'"),
        ({"image_topics": ["a", "b"]}, "image_topics has 2 names"),
        ({"start": 12.0}, "start is 12, must be -1 = anywhere, or a node of the path, 0 to 11"),
    ],
)
def test_parameters_that_cannot_be_used_are_one_line(feed: Feed, folder: Path, values: dict[str, Any], part: str) -> None:
    with pytest.raises(SettingError, match=part):
        Driven(feed, folder, **values)


def test_a_misspelt_parameter_is_warned_of_and_those_of_ros_are_not(feed: Feed, folder: Path) -> None:
    driven = Driven(feed, folder, max_liner=0.2, use_sim_time=False, **{"qos_overrides./clock.subscription.depth": 1})
    assert driven.lines == ["parameter 'max_liner' is unknown and has no effect; did you mean 'max_linear'?"]


PROGRAMS = ("path_recorder", "path_localiser", "path_policy", "path_evaluator", "camera_faults", "goggles")


def test_an_activation_that_fails_ends_the_node_with_autostart(feed: Feed, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(PathPolicyNode, "on_activate", lambda *_: TransitionCallbackReturn.FAILURE)
    with pytest.raises(PathFollowingError, match="path_policy cannot be activated"):
        Driven(feed, folder)


def test_a_transition_that_raises_stops_the_robot(feed: Feed, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(PathPolicyNode, "on_deactivate", lambda *_: 1 // 0)
    driven = Driven(feed, folder)
    driven.begin()
    driven.fed.node.trigger_deactivate()
    assert driven.speed == 0.0 and driven.fed.subscription("camera/image_raw") is None and driven.state == "inactive"
    assert driven.lines == ["the transition from active failed; configure and activate path_policy again"]
    driven.fed.node.trigger_configure()
    driven.fed.node.trigger_activate()
    driven.begin()
    assert driven.speed > 0.2


@pytest.mark.parametrize("name", PROGRAMS)
def test_help_says_what_a_node_does_and_lists_topics_and_parameters(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    module = importlib.import_module(f"gibson_path_following.nodes.{name}")
    for option in ("-h", "--help"):
        with pytest.raises(SystemExit) as ended:
            module.main([option])
        assert ended.value.code == 0
    text = capsys.readouterr().out
    assert "\nSubscribes" in text and "\nParameters:\n  " in text and "``" not in text and "options." not in text


def test_help_whose_reader_ends_is_no_error() -> None:
    end, start = os.pipe()
    os.close(end)
    with os.fdopen(start) as pipe:
        done = subprocess.run(
            [sys.executable, "-c", "from gibson_path_following.nodes.path_policy import main; main(['--help'])"],
            stdout=pipe,
            stderr=subprocess.PIPE,
            check=False,
        )
    assert (done.returncode, done.stderr) == (0, b"")


@pytest.mark.parametrize(
    ("args", "line"),
    [
        (
            ["kitchen"],
            "error: argument 'kitchen' is unknown; parameters are given as --ros-args -p NAME:=VALUE; --help lists them\n",
        ),
        (["--ros-args", "--folder", "kitchen"], "error: ROS cannot start: unknown ROS arguments: ['--folder', 'kitchen']\n"),
        *(
            (
                ["--ros-args", "-p", "spacing:=0.2", "-p", *rule],
                f"error: argument -p '{''.join(rule)}' is not NAME:=VALUE, such as -p use_sim_time:=true; --help lists the parameters\n",
            )
            for rule in (["path"], ["path=kitchen"], ["path:="], [":=kitchen"], [])
        ),
        (
            ["--ros-args", "-r", "cmd_vel"],
            "error: argument -r 'cmd_vel' is not TOPIC:=OTHER_TOPIC, such as -r odom:=wheel_odom; --help lists the topics\n",
        ),
        (["--ros-args", "-p", "path:=\udcff"], "error: argument 'path:=\\udcff' is not UTF-8\n"),
        (
            ["--ros-args", "-p", "use_sim_time:=5"],
            "error: Trying to set parameter 'use_sim_time' to '5' of type 'INTEGER', expecting type 'BOOL': use_sim_time\n",
        ),
    ],
)
@pytest.mark.usefixtures("ros_domain", "handlers")
def test_an_argument_that_cannot_be_used_is_one_line(args: list[str], line: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        run_node(Interrupted, Options, args)
    assert ended.value.code == 1 and capsys.readouterr().err == line


class Interrupted(Node):
    """Gets SIGINT while it runs, and again while it stops."""

    def __init__(self) -> None:
        super().__init__("interrupted")
        self.exit_code: int | None = None
        self.create_timer(0.01, self._interrupt)

    def _interrupt(self) -> None:
        os.kill(os.getpid(), signal.SIGINT)
        self.exit_code = 5

    def stop(self) -> None:
        os.kill(os.getpid(), signal.SIGINT)
        print("stopped")


@pytest.fixture
def handlers() -> Iterator[None]:
    """Ignores SIGINT, as in the background of a shell script, and restores the handlers that the node replaces."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.usefixtures("ros_domain", "handlers")
def test_sigint_ends_a_node_in_the_background_of_a_script_and_a_second_one_does_not_disturb_its_end(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(SystemExit) as ended:
        run_node(Interrupted, Options, [])
    assert ended.value.code == 0 and capsys.readouterr().out == "stopped\n"


class InterruptedImport(Node):
    """Gets SIGINT while it imports a package that turns KeyboardInterrupt into an error, as onnxruntime does."""

    def __init__(self) -> None:
        super().__init__("interrupted")
        try:
            os.kill(os.getpid(), signal.SIGINT)
        except KeyboardInterrupt:
            raise ModelError("goggles.onnx needs onnxruntime, which is not installed") from None


@pytest.mark.usefixtures("ros_domain", "handlers")
def test_sigint_during_an_import_that_hides_it_ends_a_node_silently(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        run_node(InterruptedImport, Options, [])
    assert ended.value.code == 0 and capsys.readouterr() == ("", "")


@pytest.mark.parametrize("name", PROGRAMS)
def test_sigint_ends_a_program_silently_while_it_imports_its_modules(name: str) -> None:
    """A finder that comes first interrupts the import of the module of the node."""
    script = (
        "import os, signal, sys\n"
        "class Interrupt:\n"
        "    def find_spec(self, name, *_):\n"
        f"        if name == 'gibson_path_following.nodes.{name}': os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.meta_path.insert(0, Interrupt())\n"
        "from importlib.metadata import entry_points\n"
        f"(program,) = entry_points(group='console_scripts', name='{name}')\n"
        "program.load()()\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (-signal.SIGINT, "", "")


@pytest.mark.usefixtures("ros_domain", "handlers")
def test_sigint_while_ros_starts_ends_a_program_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    found: list[Any] = []
    monkeypatch.setattr(running.rclpy, "init", lambda **_: found.append(signal.getsignal(signal.SIGINT)))
    with pytest.raises(SystemExit):
        run_node(Interrupted, Options, ["kitchen"])
    assert found == [signal.SIG_DFL]


def test_descriptions_and_ranges_are_declared(feed: Feed, folder: Path) -> None:
    driven = Driven(feed, folder)
    descriptor = driven.fed.node.describe_parameter("max_linear")
    assert descriptor.description == "maximum speed, m/s"
    assert (descriptor.floating_point_range[0].from_value, descriptor.floating_point_range[0].to_value) == (0.01, 10.0)


class Evaluated:
    """The evaluator of a path, and its file."""

    def __init__(self, feed: Feed, folder: Path, file: Path) -> None:
        self.file = file
        self.fed = feed(PathEvaluatorNode, path=str(folder), file=str(file))

    def robot_is_at(self, seconds: float, x: float) -> None:
        msg = Odometry()
        msg.header.stamp = conversions.time_msg(round(seconds * NS))
        msg.pose.pose.position.x, msg.pose.pose.orientation.w = x, 1.0
        self.fed.receive("ground_truth/odom", msg)

    def touch(self) -> None:
        """The robot touches an object for a moment."""
        for value in (True, False):
            self.fed.receive("bumper", Bool(data=value))

    def policy_is(self, state: str) -> None:
        self.fed.receive("path/state", String(data=state))

    @property
    def result(self) -> Any:
        return json.loads(self.file.read_text())


@pytest.fixture
def evaluated(feed: Feed, folder: Path, tmp_path: Path) -> Evaluated:
    return Evaluated(feed, folder, tmp_path / "result.json")


def test_the_evaluator_judges_from_the_first_move_to_a_second_after_the_end(evaluated: Evaluated) -> None:
    evaluated.touch()  # before the drive: it does not count
    evaluated.robot_is_at(0.0, -5.0)
    evaluated.policy_is("following")
    for k in range(23):
        evaluated.robot_is_at(1.0 + 0.25 * k, 0.1 * k)
        if k == 10:
            evaluated.touch()
    evaluated.policy_is("finished")
    evaluated.robot_is_at(7.0, 2.2)
    assert evaluated.fed.node.exit_code is None
    evaluated.robot_is_at(7.5, 2.2)
    assert evaluated.fed.node.exit_code == 0
    result = evaluated.result
    # The path is 2.2 m long, straight, and was driven whole; it was touched once.
    assert (result["success"], result["arrived"], result["coverage"], result["collisions"]) == (False, True, 1.0, 1)
    assert result["travelled"] == pytest.approx(2.2) and result["deviation_max"] == pytest.approx(0.0, abs=1e-9)
    assert [state for _, state in result["states"]] == ["following", "finished"]


def test_the_evaluator_starts_over_at_a_reset_and_says_when_there_was_no_drive(evaluated: Evaluated) -> None:
    node = evaluated.fed.node
    with pytest.raises(
        PathFollowingError, match=r"no drive was evaluated, .*result\.json is not written: path/state was never following"
    ):
        node.stop()
    evaluated.policy_is("following")
    with pytest.raises(PathFollowingError, match=r"is not written: no pose came from ground_truth/odom"):
        node.stop()
    for seconds, x in [(10.0, 0.0), (11.0, 3.0), (0.0, 0.0), (1.0, 0.4), (2.0, 0.8)]:
        evaluated.robot_is_at(seconds, x)
    assert evaluated.fed.lines == ["stamps have gone back: evaluating anew; the drive before is dropped"]
    node.stop()
    assert evaluated.result["travelled"] == pytest.approx(0.8) and evaluated.result["states"] == [[0.0, "following"]]


@pytest.mark.parametrize(
    "name",
    [
        "std_msgs/msg/Nothing",
        "nothing_msgs/msg/Bool",
        "Bool",
        "",
        "std_msgs/msg/__name__",
        "geometry_msgs/msg/Twist",
        "std_msgs/msg/String",
    ],
)
def test_a_message_type_without_collision_information_is_refused(feed: Feed, folder: Path, name: str) -> None:
    with pytest.raises(SettingError, match="collision_type is"):
        feed(PathEvaluatorNode, path=str(folder), collision_type=name)


RED_AT = {"bayer_rggb8": (0, 0), "bayer_bggr8": (1, 1), "bayer_gbrg8": (1, 0), "bayer_grbg8": (0, 1)}
"""Row and column of red in each pattern."""


@pytest.mark.parametrize("encoding", RED_AT)
def test_a_bayer_pattern_becomes_its_colour(encoding: str) -> None:
    pixels = np.zeros((8, 8), np.uint8)
    row, column = RED_AT[encoding]
    pixels[row::2, column::2] = 200
    rgb = conversions.rgb_of_image(Image(height=8, width=8, encoding=encoding, step=8, data=pixels.tobytes()))
    assert (rgb[2:6, 2:6] == (200, 0, 0)).all()


@pytest.mark.parametrize(("encoding", "pair"), [("uyvy", (128, 126)), ("yuyv", (126, 128)), ("yuv422_yuy2", (126, 128))])
def test_yuv_without_colour_becomes_grey(encoding: str, pair: tuple[int, int]) -> None:
    data = bytes(pair) * 32
    rgb = conversions.rgb_of_image(Image(height=4, width=8, encoding=encoding, step=16, data=data))
    assert (rgb == rgb[0, 0, 0]).all() and 120 <= rgb[0, 0, 0] <= 136


def test_yuv_of_an_odd_width_is_refused() -> None:
    with pytest.raises(ViewError, match="an image of 3x1 pixels is uyvy, which needs an even width; correct the camera's driver"):
        conversions.rgb_of_image(Image(height=1, width=3, encoding="uyvy", step=6, data=bytes(6)))


def test_compressed_images_are_decoded_and_those_that_are_too_large_are_refused_before() -> None:
    grey = np.full((48, 64, 3), 77, np.uint8)
    for suffix in (".png", ".jpg"):
        data = cv2.imencode(suffix, grey)[1].tobytes()
        assert (conversions.rgb_of_compressed(CompressedImage(data=data)) == 77).all()
        at = data.index(b"\xff\xc0") + 5 if suffix == ".jpg" else 18
        huge = (
            data[:at]
            + bytes([0x75, 0x30] * 2 if suffix == ".jpg" else [0x75, 0x30, 0, 0, 0x75, 0x30])
            + data[at + 4 + 2 * (at == 18) :]
        )
        with pytest.raises(
            ViewError, match="a compressed image has 30000x30000 pixels, must have 1 to 33554432; make the camera's"
        ):
            conversions.rgb_of_compressed(CompressedImage(data=huge))
        with pytest.raises(ViewError, match=r"of 12 bytes, format 'x', is neither JPEG nor PNG"):
            conversions.rgb_of_compressed(CompressedImage(data=data[:12], format="x"))
    with pytest.raises(ViewError, match="is neither JPEG nor PNG"):
        conversions.rgb_of_compressed(CompressedImage(data=cv2.imencode(".bmp", grey)[1].tobytes()))


def test_png_with_a_chunk_that_claims_gigabytes_is_refused() -> None:
    png = bytearray(cv2.imencode(".png", np.zeros((8, 8, 3), np.uint8))[1].tobytes())
    png[33:37] = (0x7FFFFFFF).to_bytes(4, "big")  # of the chunk after the header; OpenCV allocates as much
    with pytest.raises(ViewError, match="is neither JPEG nor PNG, or is damaged"):
        conversions.rgb_of_compressed(CompressedImage(format="png", data=bytes(png)))


def test_the_yaw_of_a_quaternion_does_not_depend_on_its_norm() -> None:
    msg = Odometry()
    orientation = msg.pose.pose.orientation
    orientation.z = orientation.w = 2.0 * math.sqrt(0.5)
    assert conversions.pose_from(msg) == pytest.approx((0.0, 0.0, math.pi / 2.0))
    orientation.z = orientation.w = 0.0
    assert conversions.pose_from(msg) is None, "a driver did not set it"
    orientation.w = math.nan
    assert conversions.pose_from(msg) is None


def test_an_image_that_cannot_be_used_is_one_line_and_the_next_one_is_used(feed: Feed, folder: Path) -> None:
    driven = Driven(feed, folder)
    for msg in (Image(encoding="rgb8"), Image(height=2, width=2, encoding="jpeg2000", step=2, data=bytes(4))):
        driven.fed.receive("camera/image_raw", msg)
    assert [line.partition(",")[0] for line in driven.lines] == [
        "camera/image_raw: an image of 0x0 rgb8 pixels has 0 bytes in rows of 0",
        "camera/image_raw: an image has the encoding 'jpeg2000'",
    ]
    driven.begin()
    assert driven.state == "following"


def test_covered_images_are_black_with_their_stamps_and_late_ones_wait(feed: Feed) -> None:
    fed = feed(CameraFaultsNode, cover_after=0.0, cover=0.1, delay=0.1)
    fed.now_ns = NS
    fed.receive("cmd_vel", Twist())  # a stop begins nothing
    fed.now_ns = 2 * NS
    fed.receive("cmd_vel", Twist(linear=Vector3(x=0.2)))
    for k, value in enumerate((10, 20, 30, 40)):
        msg = Image(height=1, width=1, encoding="rgb8", step=3, data=bytes([value] * 3))
        msg.header.stamp = conversions.time_msg(2 * NS + (k - 1) * NS // 10)
        fed.receive("camera/image_raw", msg)
    # Each goes out with the next one: the second, stamped 2.0 s, is covered; the last still waits.
    assert [(conversions.stamp_ns(msg.header.stamp) / NS, bytes(msg.data)) for msg in fed.sent("faulty/image_raw")] == [
        (1.9, bytes([10] * 3)), (2.0, bytes(3)), (2.1, bytes([30] * 3)),
    ]  # fmt: skip
