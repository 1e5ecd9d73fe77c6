"""``gibson_sim`` installed alone, as a package and not from the source tree: it runs, drives and records without the tools and the benchmarks."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from support.simulation import require

require("rclpy", "gibson_msgs", "pip")

pytestmark = [pytest.mark.ros, pytest.mark.egl]
OTHERS = ("gibson_sim_tools", "gibson_sim_bench")
NOT_INSTALLED = f"""import importlib.abc, importlib.metadata, sys


class Missing(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {OTHERS}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)


sys.meta_path.insert(0, Missing())
found = importlib.metadata.entry_points
importlib.metadata.entry_points = lambda **by: tuple(e for e in found(**by) if not e.value.startswith({OTHERS})) if by else found()
"""
"""What hides the other packages from every Python process: to them they are not installed."""


@pytest.fixture(scope="module")
def alone(root: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The environment in which ``gibson_sim`` is installed in a folder of its own, and the other two packages are not to be found."""
    folder, source = tmp_path_factory.mktemp("alone"), tmp_path_factory.mktemp("source") / "gibson_sim"
    # A copy: setuptools builds in the source folder, and what an earlier build left there would be installed, too.
    shutil.copytree(root / "src" / "gibson_sim", source, ignore=shutil.ignore_patterns("build", "*.egg-info", "__pycache__"))
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "--target", str(folder)]
    subprocess.run([*command, str(source)], check=True, capture_output=True, text=True)
    (folder / "sitecustomize.py").write_text(NOT_INSTALLED)
    return {**os.environ, "PYTHONPATH": str(folder)}


def _run(environment: dict[str, str], folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "gibson_sim.cli.main", *words],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )


def test_core_package_alone_simulates_drives_and_records(alone: dict[str, str], tmp_path: Path, ros_domain: int) -> None:
    bag = tmp_path / "drive"
    done = _run(
        alone, tmp_path, "run", "--scene", "flat", "--drive", "tour", "--duration", "2", "--record", str(bag), "--lockstep"
    )
    assert done.returncode == 0, done.stdout + done.stderr
    where = "import gibson_sim; print(gibson_sim.__file__)"
    found = subprocess.run([sys.executable, "-c", where], cwd=tmp_path, env=alone, capture_output=True, text=True, check=True)
    assert found.stdout.startswith(alone["PYTHONPATH"])
    checked = _run(alone, tmp_path, "bag", "check", str(bag))
    assert checked.returncode == 0, checked.stdout + checked.stderr


def test_command_of_a_missing_package_fails_in_one_line(alone: dict[str, str], tmp_path: Path) -> None:
    done = _run(alone, tmp_path, "scene", "import", "mesh.glb", "--output", "out")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == (
        "gibson-sim: error: `gibson-sim scene import` comes with the package gibson_sim_tools, which is not installed; "
        "pip install gibson_sim_tools, or src/gibson_sim_tools of Gibson Sim's sources; see `gibson-sim --help`\n"
    )


def test_help_lists_what_is_installed(alone: dict[str, str], tmp_path: Path) -> None:
    commands = _run(alone, tmp_path, "--help").stdout.split("exit codes")[0]
    assert "    run " in commands and "    bench " not in commands
