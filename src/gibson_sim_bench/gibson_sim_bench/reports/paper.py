"""The reference table of the paper, with notes on what is not comparable."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec

from gibson_sim.filling.fillers import LEARNED
from gibson_sim.types import OUTPUTS, Output

V2_HARDWARE = "GeForce GTX 1080 Ti"
V1_HARDWARE = "Xeon E5-2697 v4, Tesla V100"
PHYSICS_SIZE, RENDERING_SIZE = (256, 256), (640, 480)
"""Width and height of the images of the tables with physics and of rendering only, pixels."""
FILLED = "RGB-D, filled"
"""Name of the mode with hole filling."""
FILL = "learned" if LEARNED.is_file() and find_spec("onnxruntime") is not None else "push_pull"
"""Hole filling of that mode: the network of the package if onnxruntime can run it, otherwise push-pull."""
SENSOR_ONLY = "sensor only"


@dataclass(frozen=True, slots=True)
class Mode:
    """One mode of the table: the outputs of a frame, and the values of the paper."""

    name: str
    outputs: tuple[Output, ...]
    """Outputs of the camera; empty = no image."""
    v2: float | None = None
    """Frames per second of Gibson Env V2; None = not in the paper."""
    v1: float | None = None
    """Frames per second of Gibson Env V1."""
    note: str = ""
    """Difference to the paper, for the report."""
    fill: str = ""
    """Name of the hole filling, as in ``CameraSpec.fill``; empty = none."""


MODES = (
    Mode(
        SENSOR_ONLY,
        (),
        1017.4,
        396.1,
        "the paper does not define a frame: 24 substeps of 1/240 s would have been 24,400 Bullet steps per second. Ours: odometry, "
        "twist, joint states, all link poses, IMU, bumper; no lidar",
    ),
    Mode(
        "RGB-D, pre-filled",
        ("rgb", "depth"),
        264.2,
        58.5,
        "the paper rendered colours and depth in separate passes and read four floats per pixel; ours is one pass",
    ),
    Mode(
        FILLED,
        ("rgb", "depth"),
        61.7,
        30.6,
        "the paper's network filled colours on the GPU; ours also fills only colours, "
        + (
            "with the network of the package"
            if FILL == "learned"
            else "with push-pull, since no network can run here, and only in holes"
        ),
        FILL,
    ),
    Mode(
        "semantic only",
        ("semantic",),
        279.1,
        144.2,
        "the paper rendered one of three colours, by index modulo 3; ours are class ids",
    ),
    Mode(
        "surface normal",
        ("normal",),
        271.1,
        129.7,
        "the paper rendered all its outputs in every mode; ours renders normals and depth",
    ),
    Mode("all outputs", OUTPUTS, note="not in the paper"),
)
"""The modes."""
MODE_GROUPS = tuple(
    tuple(mode for mode in MODES if (bool(mode.outputs), mode.fill) == kind) for kind in ((False, ""), (True, ""), (True, FILL))
)
"""The modes, grouped by simulation over ROS: all cameras of a simulation have the same hole filling."""
PAPER_SCENES = (("Hillsdale", 620.4, 752.9), ("Albertville", 422.0, 688.2))
"""Name, frames per second of Gibson Env V2 and of Habitat-sim, rendering only, both on V2's hardware."""
SCAN_NOTE = (
    "the paper's scenes need a signed licence and cannot be shipped: ours are our own homes converted to scan-like meshes, one mesh with "
    "one texture; the camera path of the paper is not known either"
)
GENERAL = (
    "No script of the paper's V2 column was published: robot, scene, time step and warm-up are not known.",
    f"The V1 column was measured on another machine ({V1_HARDWARE}) than the V2 column ({V2_HARDWARE}).",
)


def mode_of(name: str) -> Mode:
    """Returns a mode by its name."""
    return next(mode for mode in MODES if mode.name == name)
