"""Use of a package that is not installed ends with one line and its remedy, never with a traceback."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from support.simulation import require

require("rclpy", "gibson_msgs")

pytestmark = pytest.mark.ros
HIDING = """import importlib.machinery, importlib.metadata, os, sys


class Hiding(importlib.machinery.PathFinder):
    @classmethod
    def find_spec(cls, name, path=None, target=None):
        return None if name.partition(".")[0] == os.environ["HIDDEN_MODULE"] else super().find_spec(name, path, target)


sys.meta_path[:] = [Hiding if finder is importlib.machinery.PathFinder else finder for finder in sys.meta_path]
"""
"""What hides a package from every Python process: to them it is not installed."""
ROS = (
    "`sudo apt install ros-jazzy-{}`, or build ros_ws and source its install/setup.bash; without a ROS installation: `make setup`"
)
CASES = (
    ("foxglove", ("web", "--foxglove"), "--foxglove needs the Python package foxglove-sdk, which is not installed: `pip install foxglove-sdk`"),
    ("foxglove", ("run", "--foxglove"), "--foxglove needs the Python package foxglove-sdk, which is not installed: `pip install foxglove-sdk`"),
    ("mcp", ("mcp",), "`gibson-sim mcp` needs the Python package mcp, which is not installed: `pip install 'gibson_sim[mcp]'`"),
    ("matplotlib", ("bag", "plot", "nowhere"), "a plot needs matplotlib, which is not installed: `pip install 'gibson_sim[analysis]'`"),
    ("playwright", ("bench", "web"), "playwright is needed: pip install 'gibson_sim_bench[web]'"),
    ("aiohttp", ("web",), "the Python package aiohttp is not installed: `pip install aiohttp`"),
    ("rosbags", ("bag", "check", "nowhere"), "the Python package rosbags is not installed: `pip install rosbags`"),
    ("cv2", ("bag", "video", "nowhere"), "the Python package opencv-python-headless is not installed: `pip install opencv-python-headless`"),
    ("simulation_interfaces", ("pause",), "the ROS package simulation_interfaces is not found: " + ROS.format("simulation-interfaces")),
    ("simulation_interfaces", ("run",), "the ROS package simulation_interfaces is not found: " + ROS.format("simulation-interfaces")),
    ("tf2_msgs", ("run",), "the ROS package tf2_msgs is not found: " + ROS.format("tf2-msgs")),
)  # fmt: skip


@pytest.fixture
def environment(tmp_path: Path, ros_domain: int) -> dict[str, str]:
    (tmp_path / "sitecustomize.py").write_text(HIDING)
    return {**os.environ, "PYTHONPATH": str(tmp_path)}


@pytest.mark.parametrize(
    ("module", "words", "line"), CASES, ids=lambda value: value if isinstance(value, str) else " ".join(value)
)
def test_package_that_is_missing_is_one_line(environment: dict[str, str], module: str, words: tuple[str, ...], line: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "gibson_sim.cli.main", *words],
        env={**environment, "HIDDEN_MODULE": module},
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    said = [text for text in (done.stdout + done.stderr).splitlines() if "error: " in text]
    assert [text.partition("error: ")[2] for text in said] == [line]
    assert "Traceback" not in done.stdout + done.stderr
    assert done.returncode != 0


@pytest.mark.parametrize("module", ["numba", "meshoptimizer", "foxglove", "matplotlib", "argcomplete"])
def test_without_an_optional_package_all_else_works(environment: dict[str, str], tmp_path: Path, module: str) -> None:
    bag = tmp_path / "bag"
    done = subprocess.run(
        [sys.executable, "-m", "gibson_sim.cli.main", "run", "--scene", "flat", "--duration", "0.5", "--record", str(bag)],
        env={**environment, "HIDDEN_MODULE": module},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "Traceback" not in done.stdout + done.stderr
