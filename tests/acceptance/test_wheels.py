"""The wheels of `make wheels` in an empty environment, without this source tree, a compiler or env.sh, and with what they require alone.

Packages of others are links to those of this Python, so that nothing is downloaded; pip installs ours.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import zipfile
from importlib.metadata import Distribution, distribution, distributions
from pathlib import Path

import cv2
import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from support.simulation import require

require("rclpy", "gibson_msgs", "pip", "wheel")
if not (Path(sys.prefix) / "gibson_setup" / "messages").is_dir():
    message = "SKIPPED: this Python is not of an environment that `make setup` made"
    pytest.skip(message, allow_module_level=True)

pytestmark = [pytest.mark.ros, pytest.mark.egl]
OURS = (
    "gibson_msgs",
    "gibson_path_following",
    "gibson_sim",
    "gibson_sim_bench",
    "gibson_sim_control_msgs",
    "gibson_sim_learn",
    "gibson_sim_rosbag2_interfaces",
    "gibson_sim_scenes",
    "gibson_sim_simulation_interfaces",
    "gibson_sim_tf2_msgs",
    "gibson_sim_tools",
)
OWN_NODE = """
import rclpy
from control_msgs.action import FollowJointTrajectory
from gibson_msgs.msg import Scene
from rclpy.action import ActionClient
from rosbag2_interfaces.srv import Pause
from simulation_interfaces.srv import StepSimulation
from tf2_msgs.msg import TFMessage

rclpy.init()
node = rclpy.create_node("mine")
made = [node.create_publisher(Scene, "scene", 1), node.create_publisher(TFMessage, "tf", 1)]
made += [node.create_client(StepSimulation, "step"), node.create_client(Pause, "pause"), ActionClient(node, FollowJointTrajectory, "follow")]
rclpy.try_shutdown()
print(len(made))
"""
WITHOUT_ROS = """
import importlib.util
import gibson_sim as gs

with gs.Simulation("arena", robot="gibson_bot", seed=0) as simulation:
    simulation.step(seconds=0.1)
    print(simulation.render("camera", outputs=["rgb"]).rgb.shape, importlib.util.find_spec("rclpy"))
"""


@pytest.fixture(scope="module")
def wheels(root: Path, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """All wheels, built anew."""
    folder = tmp_path_factory.mktemp("wheels")
    command = [sys.executable, str(root / "build_wheels.py"), "--output", str(folder)]
    subprocess.run(command, check=True, capture_output=True, text=True)
    return sorted(folder.glob("*.whl"))


@pytest.fixture(scope="module")
def installed(wheels: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The environment after `pip install 'gibson-sim[ros,scenes]' gibson-sim-tools gibson-sim-bench`. Numba would compile for ten seconds."""
    return _install(
        tmp_path_factory.mktemp("user") / "env", wheels, "gibson_sim[ros,scenes]", "gibson_sim_tools", "gibson_sim_bench"
    )


def _install(prefix: Path, wheels: list[Path], *requirements: str) -> Path:
    """Makes an environment with ``requirements`` and all that these require in turn; returns it."""
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(prefix)], check=True)
    ours = {canonicalize_name(wheel.name.partition("-")[0]): wheel for wheel in wheels}
    chosen, found = [], _closure([Requirement(text) for text in requirements], ours)
    for name in sorted(found):
        if name in ours:
            chosen.append(str(ours[name]))
        else:
            _link(distribution(name), prefix)
    pip = [sys.executable, "-m", "pip", "--python", str(prefix / "bin" / "python")]
    install = [*pip, "install", "--quiet", "--disable-pip-version-check", "--no-index", "--no-deps", *chosen]
    subprocess.run(install, check=True, capture_output=True, text=True)
    checked = subprocess.run([*pip, "check"], capture_output=True, text=True, check=False)
    assert checked.returncode == 0, checked.stdout
    return prefix


def _closure(todo: list[Requirement], ours: dict[str, Path]) -> set[str]:
    """Returns the names of all packages that ``todo`` needs; ``ours`` are wheels, the others are installed in this Python."""
    done: set[tuple[str, str]] = set()
    while todo:
        wanted = todo.pop()
        name = canonicalize_name(wanted.name)
        for extra in ("", *wanted.extras):
            if (name, extra) in done:
                continue
            done.add((name, extra))
            lines = _requires(ours[name]) if name in ours else distribution(name).requires or []
            needed = [Requirement(line) for line in lines]
            todo += [one for one in needed if one.marker is None or one.marker.evaluate({"extra": extra})]
    return {name for name, _ in done}


def _metadata(wheel: Path) -> str:
    with zipfile.ZipFile(wheel) as archive:
        (name,) = [name for name in archive.namelist() if name.endswith(".dist-info/METADATA")]
        return archive.read(name).decode()


def _requires(wheel: Path) -> list[str]:
    return re.findall(r"(?m)^Requires-Dist: (.*)$", _metadata(wheel))


def _link(package: Distribution, prefix: Path) -> None:
    """Links a package of this Python into another environment; copies libraries, beside which the loader searches others."""
    site = Path(package.locate_file(""))  # type: ignore[arg-type]
    there = prefix / site.relative_to(sys.prefix)
    for file in package.files or ():
        source = Path(os.path.normpath(site / file))
        if file.parts[0] not in ("..", "__pycache__"):
            source = site / file.parts[0]
        elif not source.is_relative_to(Path(sys.prefix) / "lib") and not source.is_relative_to(Path(sys.prefix) / "share"):
            continue
        target = prefix / source.relative_to(sys.prefix)
        if not os.path.lexists(target):
            target.parent.mkdir(parents=True, exist_ok=True)
            if ".so" in source.name and not source.is_relative_to(site):
                shutil.copy(source, target, follow_symlinks=False)
            else:
                target.symlink_to(source)
    assert there.is_dir()


def _run(prefix: Path, folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Runs a program of an environment in ``folder``: no other program is on the path, nor is this source tree."""
    kept = {
        name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "GIBSON_SIM_PATH", "AMENT_PREFIX_PATH")
    }
    environment = {**kept, "PATH": str(prefix / "bin"), "HOME": str(folder)}
    return subprocess.run(
        [str(prefix / "bin" / words[0]), *words[1:]], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )


def test_wheels_have_the_metadata_that_a_package_index_requires(wheels: list[Path]) -> None:
    assert tuple(sorted(wheel.name.partition("-")[0] for wheel in wheels)) == OURS
    tag = f"cp{sys.version_info.major}{sys.version_info.minor}"
    for wheel in wheels:
        assert wheel.stat().st_size < 100_000_000
        compiled = "msgs" in wheel.name or "interfaces" in wheel.name
        assert (
            (f"-{tag}-{tag}-" in wheel.name and "linux" in wheel.name) if compiled else wheel.name.endswith("-py3-none-any.whl")
        )
        head, _, text = _metadata(wheel).partition("\n\n")
        assert len(text.split()) > 20, f"{wheel.name} has no description"
        for key in ("Summary", "License(-Expression)?", "License-File", "Requires-Python", "Classifier"):
            assert re.search(rf"(?m)^{key}: \S", head), f"{wheel.name} has no {key}"
        with zipfile.ZipFile(wheel) as archive:
            names = archive.namelist()
            assert any(re.search(r"\.dist-info/(licenses/)?LICENSE$", name) for name in names)
            assert not [name for name in names if "__pycache__" in name or name.endswith(".cmake") or "/." in name]
            assert not [
                name for name in names if str(Path(sys.prefix)).encode() in archive.read(name) and not name.endswith(".so")
            ]


def test_pip_installation_renders_a_first_image(installed: Path, tmp_path: Path, ros_domain: int) -> None:
    """The process that starts it is of another environment with ROS from pip, whose variables it inherits."""
    done = _run(installed, tmp_path, "gibson-sim", "run", "--snapshot", "pictures")
    assert done.returncode == 0, done.stdout + done.stderr
    picture = cv2.imread(str(tmp_path / "pictures" / "camera_rgb.png"))
    assert picture is not None and picture.shape == (480, 640, 3)
    assert picture.std() > 20
    where = _run(
        installed, tmp_path, "python", "-c", "import gibson_sim, gibson_msgs; print(gibson_sim.__file__, gibson_msgs.__file__)"
    )
    assert all(Path(file).is_relative_to(installed) for file in where.stdout.split()) and where.stdout


def test_a_user_node_finds_the_message_packages(
    installed: Path, tmp_path: Path, ros_domain: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("LD_LIBRARY_PATH", "_ROS_WHEELS_BOOTSTRAP_COMPLETE"):
        monkeypatch.delenv(name, raising=False)  # of this Python, which a shell of the user has not
    done = _run(installed, tmp_path, "python", "-c", OWN_NODE)
    assert (done.stdout, done.returncode) == ("5\n", 0), done.stderr


def test_tools_and_benchmarks_add_their_commands(installed: Path, tmp_path: Path) -> None:
    assert "table1" in _run(installed, tmp_path, "gibson-sim", "bench", "--help").stdout
    checked = _run(installed, tmp_path, "gibson-sim", "scene", "check", "linden_flat")
    assert checked.returncode == 0, checked.stdout + checked.stderr


def test_a_script_needs_no_ros(wheels: list[Path], tmp_path: Path) -> None:
    prefix = _install(tmp_path / "env", wheels, "gibson_sim[scenes]")
    done = _run(prefix, tmp_path, "python", "-c", WITHOUT_ROS)
    assert (done.stdout, done.returncode) == ("(480, 640, 3) None\n", 0), done.stderr
    names = {
        canonicalize_name(package.name) for package in distributions(path=[str(next(prefix.glob("lib/python3.*/site-packages")))])
    }
    assert not {name for name in names if name.startswith("ros-")}
