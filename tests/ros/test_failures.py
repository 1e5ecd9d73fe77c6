"""Failures: their messages, and what they leave behind."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from gibson_sim.processes.shared_memory import remove_dead_segments
from support.scenes import write_room, write_square_obj, write_triangle_glb
from support.simulation import Launched, Listener, require, wait_until

require("rclpy", "gibson_msgs")

from rclpy.qos import qos_profile_sensor_data  # noqa: E402
from rosbags.highlevel import AnyReader  # noqa: E402
from rosgraph_msgs.msg import Clock  # noqa: E402

pytestmark = pytest.mark.ros


def test_mesh_cut_in_half_is_named_in_one_line(ros_domain: int, tmp_path: Path) -> None:
    room = write_room(tmp_path / "room", "  - {name: thing, mesh: thing.glb}\n")
    whole = write_triangle_glb(room / "thing.glb").read_bytes()
    (room / "thing.glb").write_bytes(whole[: len(whole) // 2])
    launched = Launched("run", "--scene", str(room), "--record", str(tmp_path / "bag"), "--reserve-mb", "10")
    assert launched.wait() == 1
    assert launched.lines[-1].startswith("error:")
    assert "thing.glb" in launched.lines[-1]
    # Only the physics node logs before its scene is loaded, and nothing is recorded.
    assert not any("Traceback" in line or line.startswith(("render", "record")) for line in launched.lines)
    assert not (tmp_path / "bag").exists()


def test_missing_texture_warns_and_draws(ros_domain: int, tmp_path: Path) -> None:
    room = write_room(tmp_path / "room", "  - {name: square, mesh: square.obj, pose: {xyz: [1.0, 0.0, 0.0]}}\n")
    write_square_obj(room, "not_there.png")
    launched = Launched("run", "--scene", str(room), "--snapshot", str(tmp_path / "shots"))
    assert launched.wait() == 0, "\n".join(launched.lines)
    assert any("WARN" in line and "not_there.png" in line for line in launched.lines)
    assert any("render: camera camera, " in line and " 0 images" not in line for line in launched.lines)


def test_error_without_egl_names_the_packages_to_install(ros_domain: int, tmp_path: Path) -> None:
    launched = Launched("run", "--scene", str(write_room(tmp_path)), "--egl-library", "libNoSuchEGL.so.1")
    assert launched.wait() == 1
    error = next(line for line in launched.lines if line.startswith("error:"))
    assert "libNoSuchEGL.so.1" in error
    assert "libegl1" in error


def test_physics_runs_alone_without_egl(ros_domain: int, tmp_path: Path) -> None:
    launched = Launched("run", "--scene", str(write_room(tmp_path)), "--no-render", "--duration", "1", "--rate", "max")
    assert launched.wait() == 0, "\n".join(launched.lines)
    assert any("1.00 s simulated" in line for line in launched.lines)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_stopped_run_ends_with_zero_and_leaves_nothing_behind(listener: Listener, tmp_path: Path, number: signal.Signals) -> None:
    clock = listener.collect(Clock, "/clock", qos_profile_sensor_data)
    launched = Launched("run", "--scene", str(write_room(tmp_path)))
    launched.wait_for_line("triangles")
    listener.spin_until(lambda: any(message.clock.sec > 0 for message in clock), "time that has begun")
    pids = [launched.node_pid("physics"), launched.node_pid("render")]
    segments = _own_segments(*pids)
    assert launched.stop(number) == 0, "\n".join(launched.lines)
    assert not any(_alive(pid) for pid in pids)
    assert _left_behind(segments) == []


def test_nodes_end_when_the_launcher_is_killed(ros_domain: int, tmp_path: Path) -> None:
    temporary = tmp_path / "tmp"
    temporary.mkdir()
    launched = Launched("run", "--scene", str(write_room(tmp_path)), env={"TMPDIR": str(temporary)})
    launched.wait_for_line("triangles")
    pids = [launched.node_pid("physics"), launched.node_pid("render")]
    assert list(temporary.glob("gibson-sim-job-*"))
    launched.stop(signal.SIGKILL)
    wait_until(lambda: not any(_alive(pid) for pid in pids), "end of the nodes")
    assert [path.name for path in temporary.iterdir() if path.is_dir()] == []


def test_death_of_physics_ends_the_run_and_its_shared_memory_is_cleaned_up(ros_domain: int, tmp_path: Path) -> None:
    launched = Launched("run", "--scene", str(write_room(tmp_path)))
    launched.wait_for_line("triangles")
    segments = _own_segments(launched.node_pid("physics"), launched.node_pid("render"))
    os.kill(launched.node_pid("physics"), signal.SIGKILL)
    assert launched.wait() == 4
    assert any("the physics node was killed by SIGKILL" in line for line in launched.lines)
    assert [path for path in _left_behind(segments) if "_port" not in path] == []
    remove_dead_segments()  # as the next run does: ports that others had open at the end
    assert _left_behind(segments) == []


def test_physics_node_started_by_hand_ends_if_another_machine_publishes_time(ros_domain: int, listener: Listener) -> None:
    # The lock does not cover simulations on other machines: their topics do.
    listener.node.create_publisher(Clock, "/clock", 1)
    command = [sys.executable, "-m", "gibson_sim.ros.nodes.physics_node", "--ros-args", "-p", "scene:=arena"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 1, done.stderr
    assert "another node publishes /clock in this ROS domain" in done.stderr


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 30 MB of our own."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=30m", "tmpfs", str(folder)], capture_output=True, check=False)
    if mounted.returncode != 0:
        pytest.skip("SKIPPED: a small disk can be made by root alone; tests/unit/bags covers a full disk without it")
    yield folder
    subprocess.run(["umount", "-l", str(folder)], check=True)


def test_full_disk_ends_the_recording_and_not_the_run(ros_domain: int, tmp_path: Path, small_disk: Path) -> None:
    # In lockstep every image is drawn, 60 MB in all, however slow the machine is.
    options = ("--lockstep", "--duration", "3", "--record", str(small_disk / "bag"), "--reserve-mb", "10")
    launched = Launched("run", "--scene", str(write_room(tmp_path / "room")), *options)
    assert launched.wait() == 5, "\n".join(launched.lines)
    assert any("the recording ended early" in line and "the simulation goes on" in line for line in launched.lines)
    assert any("3.00 s simulated" in line for line in launched.lines)
    with AnyReader([small_disk / "bag"]) as reader:
        images = sum(1 for c, _, data in reader.messages() if c.topic == "/camera/image_raw" and len(data) > 640 * 480 * 3)
    assert images > 3


def _alive(pid: int) -> bool:
    try:
        return "State:\tZ" not in Path(f"/proc/{pid}/status").read_text()
    except FileNotFoundError:
        return False


def _segments(*pids: int) -> set[str]:
    """Returns the files of shared memory that processes use."""
    found: set[str] = set()
    for pid in pids:
        with contextlib.suppress(OSError):
            found.update(re.findall(r"/dev/shm/fastrtps_\S+", Path(f"/proc/{pid}/maps").read_text()))
    return found


def _own_segments(*pids: int) -> set[str]:
    """Returns those that no process beside them and their client, which is this one, uses: some are shared by all simulations of a machine."""
    others = {int(path.name) for path in Path("/proc").iterdir() if path.name.isdecimal()} - {*pids, os.getpid()}
    return _segments(*pids) - _segments(*others)


def _left_behind(segments: set[str]) -> list[str]:
    """Returns those that still exist but are not in use."""
    assert segments, "the nodes had no shared memory of their own"
    used = _segments(*(int(path.name) for path in Path("/proc").iterdir() if path.name.isdecimal()))
    return sorted(path for path in segments - used if Path(path).exists())
