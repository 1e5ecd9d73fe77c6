#!/usr/bin/env python3
"""The way of a user with ROS: colcon build --symlink-install, source, launch, one picture, every scene, a clean end.

    tests/acceptance/journey.py                         on the environment that `make setup` made
    tests/acceptance/journey.py --ros /opt/ros/jazzy    on a ROS installation

On a ROS installation everything in ros_ws is built and `ros2 launch` starts the simulation. The environment of `make setup` has neither
launch nor ros2cli, but it has our messages: there the Python packages are built, and one package of messages to see that it is not built
a second time; and what the installed launch file says is started without launch. Each step is one line; the exit code is 1 where one fails.
"""

from __future__ import annotations

import argparse
import os
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
PATIENCE_S = 300.0
"""How long one step may take before it counts as hung; a machine that compiles loops for the first time is slow."""
FIRST_SCENE = "flat"
FOREIGN = (
    "AMENT_PREFIX_PATH", "CMAKE_PREFIX_PATH", "COLCON_PREFIX_PATH", "LD_LIBRARY_PATH", "PYTHONHOME", "PYTHONPATH", "VIRTUAL_ENV",
    "_ROS_WHEELS_BOOTSTRAP_COMPLETE",
)  # fmt: skip
"""What a shell that was opened for this would not have."""


class JourneyError(Exception):
    """A step did not go as it must."""


def say(what: str, since: float) -> None:
    """Prints that a step went well."""
    print(f"ok  {what} ({time.monotonic() - since:.1f} s)", flush=True)


def require(condition: object, what: str) -> None:
    """Ends the journey where ``condition`` does not hold."""
    if not condition:
        raise JourneyError(what)


def underlay(ros: Path | None) -> list[str]:
    """Returns the lines of a shell that has the ROS installation, or else the environment of this interpreter."""
    if ros is not None:
        return [f"source {shlex.quote(str(ros / 'setup.bash'))}"]
    prefix = shlex.quote(sys.prefix)
    return [f"export AMENT_PREFIX_PATH={prefix} CMAKE_PREFIX_PATH={prefix} PATH={prefix}/bin:$PATH"]


def shell(lines: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    """Runs lines in a shell of its own, in ``folder``."""
    env = {name: value for name, value in os.environ.items() if name not in FOREIGN}
    env["COLCON_HOME"] = str(folder / "colcon")
    return subprocess.run(
        ["bash", "-c", "\n".join(["set -e", *lines])], cwd=folder, env=env, stdout=subprocess.PIPE, text=True, check=False
    )


def build(ros: Path | None, folder: Path) -> None:
    """Builds the workspace with links."""
    since = time.monotonic()
    command = ["colcon", "--log-base", "log", "build", "--symlink-install", "--base-paths", str(ROOT / "ros_ws" / "src")]
    if ros is None:
        command += ["--packages-select", "gibson_sim", "gibson_sim_tools", "gibson_sim_learn", "gibson_sim_bench"]
        command += ["gibson_examples", "gibson_path_following", "control_msgs"]
        command += ["--cmake-args", "-G", "Ninja", f"-DPython3_EXECUTABLE={sys.executable}", "--no-warn-unused-cli"]
    done = shell([*underlay(ros), f"{shlex.join(command)} 2> build.log"], folder)
    require(done.returncode == 0, f"colcon ended with {done.returncode}\n{done.stdout}\n{(folder / 'build.log').read_text()}")
    share = folder / "install" / "gibson_sim" / "share" / "gibson_sim"
    files = [share / "package.xml", share / "launch" / "sim.launch.py", *share.glob("scenes/*/scene.yaml")]
    wrong = [str(file) for file in files if not file.is_symlink() or not file.is_file()]
    require(len(files) > 10 and not wrong, f"these are no links to files: {', '.join(wrong)}, of {len(files)}")
    if ros is None:
        require(not list((folder / "install" / "control_msgs").rglob("*.so")), "control_msgs hides the one of the environment")
    say(f"colcon build --symlink-install: {len(files) - 2} scenes installed as links", since)


def travel(ros: Path | None, folder: Path) -> None:
    """Builds, then does the rest in a shell in which the workspace is sourced."""
    build(ros, folder)
    setup = next(file for file in (folder / "install" / f"setup.{kind}" for kind in ("bash", "sh")) if file.is_file())
    lines = [*underlay(ros), f"source {shlex.quote(str(setup))}"]
    done = shell(
        [*lines, f"exec python3 {shlex.quote(str(Path(__file__).resolve()))} --sourced {shlex.quote(str(folder))}"], folder
    )
    print(done.stdout, end="", flush=True)
    require(done.returncode == 0, f"in the sourced workspace: exit code {done.returncode}")


class Simulation:
    """What `ros2 launch gibson_sim sim.launch.py` starts."""

    def __init__(self, log: Path) -> None:
        self._log = log
        with log.open("w") as out:
            commands, env = self._commands()
            self._processes = [
                subprocess.Popen(command, env=env, stdout=out, stderr=subprocess.STDOUT, start_new_session=True)
                for command in commands
            ]

    def _commands(self) -> tuple[list[list[str]], dict[str, str]]:
        if shutil.which("ros2"):
            self.how = "ros2 launch"
            return [["ros2", "launch", "gibson_sim", "sim.launch.py", f"scene:={FIRST_SCENE}"]], dict(os.environ)
        self.how = "the launch file's nodes"
        sys.path.insert(0, str(ROOT / "tests"))
        import pytest
        from ament_index_python.packages import get_package_prefix, get_package_share_directory

        from support.launching import LaunchFile

        file = Path(get_package_share_directory("gibson_sim")) / "launch" / "sim.launch.py"
        said = LaunchFile(file, pytest.MonkeyPatch()).start(f"scene:={FIRST_SCENE}")
        env = {**os.environ, **dict(action.given for action in said if action.kind == "SetEnvironmentVariable")}
        commands = []
        for node in (action.options for action in said if action.kind == "Node"):
            program = Path(get_package_prefix(node["package"])) / "lib" / node["package"] / node["executable"]
            commands.append(
                [str(program), "--ros-args", *(text for file in node["parameters"] for text in ("--params-file", str(file)))]
            )
        require(len(commands) == 2, f"the launch file starts {commands}")
        return commands, env

    def output(self) -> str:
        """Returns what it has said."""
        return self._log.read_text()

    def check(self) -> None:
        """Ends the journey where a process has ended."""
        require(all(process.poll() is None for process in self._processes), f"the simulation ended:\n{self.output()}")

    def stop(self) -> None:
        """Presses Ctrl-C, and looks that nothing stays."""
        for process in self._processes:
            process.send_signal(signal.SIGINT)
        codes = [process.wait(PATIENCE_S) for process in self._processes]
        require(not any(codes), f"exit codes {codes}:\n{self.output()}")
        left = [
            path.parent.name for path in Path("/proc").glob("[0-9]*/stat") if _session(path) in {p.pid for p in self._processes}
        ]
        require(not left, f"processes {left} are still there")
        wrong = [line for line in self.output().splitlines() if "Traceback" in line or "ERROR" in line or "FATAL" in line]
        require(not wrong, "it said: " + "\n".join(wrong))

    def kill(self) -> None:
        """Ends what is left of it."""
        for process in self._processes:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()


def _session(stat: Path) -> int:
    """Returns the session of a process, by its file in /proc; 0 where it has gone."""
    try:
        return int(stat.read_text().rpartition(")")[2].split()[3])
    except (OSError, ValueError):
        return 0


class Client:
    """A node of the user."""

    def __init__(self, simulation: Simulation) -> None:
        import rclpy

        rclpy.init()
        self._rclpy, self._simulation = rclpy, simulation
        self.node = rclpy.create_node("traveller")

    def wait(self, condition: Callable[[], bool], what: str) -> None:
        """Listens until ``condition`` holds."""
        end = time.monotonic() + PATIENCE_S
        while not condition():
            self._simulation.check()
            require(time.monotonic() < end, f"no {what} in {PATIENCE_S:.0f} s:\n{self._simulation.output()}")
            self._rclpy.spin_once(self.node, timeout_sec=0.1)

    def call(self, kind: Any, name: str, request: Any) -> Any:
        """Returns what a service answers."""
        service = self.node.create_client(kind, name)
        self.wait(service.service_is_ready, f"service {name}")
        future = service.call_async(request)
        self.wait(future.done, f"answer of {name}")
        self.node.destroy_client(service)
        return future.result()

    def picture(self) -> Any:
        """Returns an image of the camera."""
        from sensor_msgs.msg import Image

        images: list[Any] = []
        subscription = self.node.create_subscription(Image, "camera/image_raw", images.append, 1)
        self.wait(lambda: bool(images), "picture")
        self.node.destroy_subscription(subscription)
        return images[0]

    def close(self) -> None:
        """Leaves ROS."""
        self.node.destroy_node()
        self._rclpy.try_shutdown()


def use(folder: Path) -> None:
    """Does what a user does in a sourced workspace that was built in ``folder``."""
    from simulation_interfaces.srv import GetAvailableWorlds, LoadWorld

    import gibson_sim
    from gibson_sim.resources import find_scene

    require(Path(gibson_sim.__file__).is_relative_to(folder), f"gibson_sim comes from {gibson_sim.__file__}, not from {folder}")
    since = time.monotonic()
    simulation = Simulation(folder / "simulation.log")
    client = None
    try:
        client = Client(simulation)
        image = client.picture()
        require(len(set(bytes(image.data))) > 20, "the picture is empty")
        say(f"{simulation.how}: a picture of {image.width}x{image.height}", since)
        since = time.monotonic()
        worlds = client.call(GetAvailableWorlds, "get_available_worlds", GetAvailableWorlds.Request()).worlds
        names = [world.world_resource.uri for world in worlds]
        ours = [name for name in names if find_scene(name).is_relative_to(folder / "install")]
        require(len(ours) >= 10, f"scenes of the workspace: {ours}, of {names}")
        for name in ours:
            result = client.call(LoadWorld, "load_world", LoadWorld.Request(uri=name)).result
            require(result.result == result.RESULT_OK, f"{name}: {result.error_message}")
        say(f"load_world: {len(ours)} scenes", since)
        since = time.monotonic()
        simulation.stop()
        say("Ctrl-C: all ended with 0, and nothing was left", since)
    finally:
        if client is not None:
            client.close()
        simulation.kill()


def main() -> int:
    """Returns the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument(
        "--ros", type=Path, metavar="FOLDER", help="a ROS 2 Jazzy installation (default: the environment of this Python)"
    )
    parser.add_argument("--folder", type=Path, help="where to build; stays (default: a temporary folder)")
    parser.add_argument("--sourced", type=Path, help=argparse.SUPPRESS)
    args = parser.parse_args()
    os.environ.setdefault("ROS_DOMAIN_ID", "77")
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    try:
        if args.sourced:
            use(args.sourced)
        elif args.folder:
            args.folder.mkdir(parents=True, exist_ok=True)
            travel(args.ros, args.folder.resolve())
        else:
            with tempfile.TemporaryDirectory(prefix="gibson_sim_journey_") as folder:
                travel(args.ros, Path(folder).resolve())
    except JourneyError as error:
        print(f"FAIL {error}", flush=True)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
