"""The reference table of the paper, and what is not comparable."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec

from gibson_sim.filling.fillers import LEARNED
from gibson_sim.types import OUTPUTS, Output

V2_HARDWARE = "GeForce GTX 1080 Ti"
V1_HARDWARE = "Xeon E5-2697 v4, Tesla V100"
PHYSICS_SIZE, HOUSE_SIZE = (256, 256), (640, 480)
"""Width and height of the images of the two tables, pixels."""
FILLED = "RGB-D, filled"
FILL = "learned" if LEARNED.is_file() and find_spec("onnxruntime") is not None else "push_pull"
"""What fills the holes in that row: the network of the package where it can run."""
SENSOR_ONLY = "sensor only"


@dataclass(frozen=True, slots=True)
class Mode:
    """One row of the table: the outputs of a frame, and the values of the paper."""

    name: str
    outputs: tuple[Output, ...]
    """Outputs of the camera; empty = no image."""
    v2: float | None = None
    """Frames per second of Gibson Env V2; None = the paper has no such row."""
    v1: float | None = None
    """Frames per second of Gibson Env V1."""
    note: str = ""
    """What is not comparable."""
    fill: str = ""
    """What fills holes of the images; empty = nothing."""


MODES = (
    Mode(
        SENSOR_ONLY,
        (),
        1017.4,
        396.1,
        "the paper does not say what a frame is: 24 substeps of 1/240 s would have been 24,400 Bullet steps a second. Ours: odometry, "
        "twist, joints and the poses of everything, IMU, bumper; no lidar",
    ),
    Mode(
        "RGB-D, pre-filled",
        ("rgb", "depth"),
        264.2,
        58.5,
        "the paper drew twice, once for colours and once for depth, and read four floats a pixel; ours is one pass",
    ),
    Mode(
        FILLED,
        ("rgb", "depth"),
        61.7,
        30.6,
        "the paper's network filled colours on the GPU; ours, too, fills colours alone, "
        + (
            "by the network of the package"
            if FILL == "learned"
            else "by push-pull, for there is no network here, and only where there are holes"
        ),
        FILL,
    ),
    Mode(
        "semantic only", ("semantic",), 279.1, 144.2, "the paper's is one of three colours, by number modulo 3; ours are classes"
    ),
    Mode(
        "surface normal", ("normal",), 271.1, 129.7, "the paper drew all its outputs in every mode; ours draws normals and depth"
    ),
    Mode("all outputs", OUTPUTS, note="not in the paper"),
)
"""The rows."""
TOGETHER = tuple(
    tuple(mode for mode in MODES if (bool(mode.outputs), mode.fill) == kind) for kind in ((False, ""), (True, ""), (True, FILL))
)
"""The rows by the simulation over ROS that makes them: its cameras are all filled, or none."""
HOUSES = (("Hillsdale", 620.4, 752.9), ("Albertville", 422.0, 688.2))
"""Name, frames per second of Gibson Env V2 and of Habitat-sim, rendering only, both on V2's hardware."""
HOUSE_NOTE = (
    "the paper's scenes need a signed licence and cannot be shipped: ours are houses of ours made into what a scan would give, one mesh "
    "with one texture; the way of the camera is not known either"
)
GENERAL = (
    "No script of the paper's V2 column was published: robot, scene, time step and warm-up are not known.",
    f"The V1 column was measured on another machine ({V1_HARDWARE}) than the V2 column ({V2_HARDWARE}).",
)


def mode_of(name: str) -> Mode:
    """Returns a row by its name."""
    return next(mode for mode in MODES if mode.name == name)
