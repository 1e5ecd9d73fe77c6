"""Protocol of the paper's table: robot, time step, commands, number of measurements. Imports neither ROS, physics nor OpenGL."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

from gibson_sim.reading import read_yaml_file
from gibson_sim.resources import find_robot
from gibson_sim.writing import write_file
from gibson_sim_bench.reports.paper import FILL, FILLED, Mode

STEP_HZ = 240
SUBSTEPS = (24, 4, 1)
"""Physics steps per frame."""
COMMANDS_PER_S = 10
"""Commands per second of simulation time."""
SCAN_SCENES = ("scan:linden_flat:300k", "scan:garden_house:500k")
"""Scan-like meshes; the second has two floors."""
RENDERING_ONLY = "houses"
"""Name of the part that renders ``SCAN_SCENES`` without physics."""
PARTS = ("in process", "lockstep", "free-running", RENDERING_ONLY)
"""Parts of the table that can be measured separately, in its order."""
FOV_Y_DEG = 90.0
"""Vertical field of view of the camera, degrees."""
ROBOT = "gibson_bot"
RENDERING_MODES = (Mode("RGB", ("rgb",)), Mode("RGB-D", ("rgb", "depth")), Mode(FILLED, ("rgb", "depth"), fill=FILL))
WARM_UP = 10
"""Minimum number of frames of the warm-up, which do not count."""
SETTLE_S = 4.0
"""Simulation time before the first frame, seconds: by then bodies at rest sleep, in every row."""
BLOCK = 12
"""Frames of an interleaved block."""
TICK_WARM_UP = 3
"""Ticks at the start of each block, which do not count."""


@dataclass(frozen=True, slots=True)
class Table1Plan:
    """Parts, scenes and number of measurements."""

    scene: str = "linden_flat"
    scan_scenes: tuple[str, ...] = SCAN_SCENES
    substeps: tuple[int, ...] = SUBSTEPS
    frames: int = 150
    """Frames of each mode with images."""
    sensor_frames: int = 1500
    """Frames of the mode without images."""
    seconds: float = 4.0
    """Wall time for each mode of the free-running simulation, seconds."""
    parts: tuple[str, ...] = PARTS
    device: int | str | None = None

    @classmethod
    def quick(cls) -> Table1Plan:
        """Returns a plan of about three minutes."""
        return cls(substeps=(24, 1), frames=40, sensor_frames=300, seconds=1.5)


def write_robot(folder: Path, size: tuple[int, int]) -> Path:
    """Writes the robot of the table, ``ROBOT`` with one camera of 90 degrees and without lidar, into a folder; returns its file."""
    return write_changed_robot(folder, size, fov_y_deg=FOV_Y_DEG, lidar=False)


def write_changed_robot(folder: Path, size: tuple[int, int], *, fov_y_deg: float | None = None, lidar: bool = True) -> Path:
    """Writes ``ROBOT`` with another image size into a folder; returns its file.

    Args:
        folder: folder of the file.
        size: width and height of the images, pixels.
        fov_y_deg: vertical field of view, degrees; None = unchanged.
        lidar: whether the robot keeps its lidar.
    """
    home = find_robot(ROBOT)
    settings = read_yaml_file(home / "robot.yaml")
    settings["urdf"] = str((home / settings["urdf"]).resolve())
    camera = {**settings["cameras"][0], "width": size[0], "height": size[1]}
    settings["cameras"] = [camera if fov_y_deg is None else {**camera, "fov_y_deg": fov_y_deg}]
    if not lidar:
        del settings["lidar"]
    path = folder / "robot.yaml"
    write_file(path, yaml.safe_dump(settings))
    return path


class RandomCommands:
    """Random velocity commands, (m/s, rad/s), from seed 0. Their mean is 0, so that the robot stays near its start in every row."""

    def __init__(self, substeps: int) -> None:
        self._rng = np.random.default_rng(0)
        self._frames = max(1, STEP_HZ // COMMANDS_PER_S // substeps)
        self._frame = 0
        self._command = (0.0, 0.0)

    def next(self) -> tuple[float, float]:
        """Returns linear and angular velocity of the next frame, m/s and rad/s."""
        if self._frame % self._frames == 0:
            self._command = float(self._rng.uniform(-0.2, 0.2)), float(self._rng.uniform(-1.0, 1.0))
        self._frame += 1
        return self._command
