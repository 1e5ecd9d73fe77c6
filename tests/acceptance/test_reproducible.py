"""Repeated runs are bit-equal: two cameras, a lidar, an IMU with noise, and a controller in a process of its own.

By default 300 ticks, over two starts; ``GIBSON_REPRODUCIBLE_RUNS=10`` makes it 1,000 ticks over ten.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from support.simulation import Launched, Listener, new_context, require

require("rclpy", "gibson_msgs", "simulation_interfaces")

from support.clients import client_of  # noqa: E402
from support.lockstep import NAME, Controller, Digests  # noqa: E402
from support.robots import GIBSON_BOT, write_gibson_bot  # noqa: E402

pytestmark = pytest.mark.ros
RUNS = int(os.environ.get("GIBSON_REPRODUCIBLE_RUNS", "0"))
TICKS, STARTS = (1000, RUNS) if RUNS else (300, 2)
STEPS_A_TICK = 4
IMAGES = ("camera/image_raw", "camera/depth/image_raw", "left/image_raw", "left/depth/image_raw")


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Our robot with two small cameras and sensors that are noisy."""
    folder = tmp_path_factory.mktemp("robot")
    one = yaml.safe_load(GIBSON_BOT.read_text(encoding="utf-8"))["cameras"][0]
    noise = {"depth_noise": {"constant": 0.001, "quadratic": 0.002}, "effects": {"shot_noise": 0.02, "read_noise": 0.005}}
    small = {**one, "width": 160, "height": 120, "rate_hz": 6.0, **noise}
    left = {
        **small,
        "name": "left",
        "rate_hz": 4.0,
        "link": "base_link",
        "pose": {"xyz": [0.1, 0.0, 0.3], "rpy_deg": [0, 10, 60]},
    }
    lidar = {"link": "base_scan", "beams": 360, "range_min": 0.12, "range_max": 12.0, "rate_hz": 10.0, "range_noise": 0.01}
    imu = {"link": "base_link", "rate_hz": 120.0, "gyro_noise": 0.001, "accel_noise": 0.01}
    return write_gibson_bot(folder / "robot", cameras=[small, left], lidar=lidar, imu=imu)


@contextlib.contextmanager
def busy_machine() -> Iterator[None]:
    """Another job takes both cores meanwhile."""
    jobs = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(2)]
    try:
        yield
    finally:
        for job in jobs:
            job.kill()
            job.wait()


def _run(robot: Path, *options: str, lockstep: bool = True, resets: int = 0) -> list[Digests]:
    """Returns the digests of a run, of each epoch by itself: (0, step, topic) -> digest."""
    told = ["--lockstep", "--participants", NAME, "--rate", "max"] if lockstep else ["--rate", "1"]
    launched = Launched("run", "--robot", str(robot), "--digests", "--seed", "7", *told, *options)
    context = new_context()
    listener = Listener(context)
    try:
        launched.wait_for_line("triangles")
        controller = Controller(listener, images=IMAGES, takes_part=lockstep)
        control = client_of(listener)
        for epoch in range(resets + 1):
            # The last tick with its image. What runs free may have passed it before this process heard of it.
            last = {(epoch, TICKS * STEPS_A_TICK, topic) for topic in ("/scene_state", f"/{IMAGES[0]}")}
            listener.spin_until(
                lambda last=last: last <= controller.digests.keys() if lockstep else _is_past(controller.digests),
                f"{TICKS} ticks",
            )
            if epoch < resets:
                control.reset()
        launched.stop()
    finally:
        launched.stop()
        listener.close()
        context.try_shutdown()
    found = controller.digests
    return [
        {(0, step, topic): digest for (e, step, topic), digest in found.items() if e == epoch and step <= TICKS * STEPS_A_TICK}
        for epoch in range(resets + 1)
    ]


def _is_past(digests: Digests) -> bool:
    return any(step >= TICKS * STEPS_A_TICK for _, step, _ in digests)


def _differing(a: Digests, b: Digests) -> list[tuple[int, int, str]]:
    return sorted(key for key in a.keys() | b.keys() if a.get(key) != b.get(key))


@pytest.fixture(scope="module")
def first(ros_domain: int, robot: Path) -> list[Digests]:
    """The run, and the same again after a reset."""
    return _run(robot, resets=1)


def test_every_tick_and_every_due_image_has_a_digest(first: list[Digests]) -> None:
    topics = {topic for _, _, topic in first[0]}
    assert topics >= {"/scene_state", "/odom", "/ground_truth/odom", "/joint_states", "/scan", "/imu", *(f"/{t}" for t in IMAGES)}
    ticks = [step for _, step, topic in first[0] if topic == "/scene_state"]
    assert sorted(ticks) == list(range(STEPS_A_TICK, TICKS * STEPS_A_TICK + 1, STEPS_A_TICK))
    for topic, every in (("/camera/image_raw", 10), ("/left/depth/image_raw", 15), ("/scan", 6)):
        assert sum(t == topic for _, _, t in first[0]) == TICKS // every, topic


def test_run_after_a_reset_equals_the_first_run(first: list[Digests]) -> None:
    assert _differing(*first) == []


@pytest.mark.parametrize("start", range(1, STARTS))
def test_restarted_simulation_repeats_the_run_also_on_a_busy_machine(first: list[Digests], robot: Path, start: int) -> None:
    with busy_machine() if start % 2 else contextlib.nullcontext():
        (again,) = _run(robot)
    assert _differing(first[0], again) == []


def test_pipelined_runs_are_repeatable_and_differ_from_unpipelined_runs(first: list[Digests], robot: Path) -> None:
    one, after_reset = _run(robot, "--pipelined", resets=1)
    with busy_machine():
        (again,) = _run(robot, "--pipelined")
    assert _differing(one, after_reset) == []
    assert _differing(one, again) == []
    assert one.keys() == first[0].keys()
    assert _differing(one, first[0]), "a command takes effect one tick later"


def test_run_without_lockstep_differs(first: list[Digests], robot: Path) -> None:
    """Shows that the digests of this file can differ: the controller's answers arrive when they arrive."""
    with busy_machine():
        (free,) = _run(robot, lockstep=False)
    common = first[0].keys() & free.keys()
    assert any(first[0][key] != free[key] for key in common)
