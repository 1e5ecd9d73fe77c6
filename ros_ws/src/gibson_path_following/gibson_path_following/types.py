"""Shared data types: images, nodes of a path, velocities, places on the path; and the protocol of a policy.

Frames and units: REP-103; velocities in the frame of the robot, x forward, positive yaw rate to the left. No ROS here: the nodes, and the
benchmarks that run without ROS, use the same classes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

CameraKind = Literal["pinhole", "fisheye_pair"]
"""One pinhole camera that looks ahead; or two fisheyes of 180 degrees, front and back, which cover 360 degrees."""
IMAGES_OF: dict[CameraKind, tuple[str, ...]] = {"pinhole": ("front",), "fisheye_pair": ("front", "back")}
"""Names of the images of a view, in their order."""
Image = NDArray[np.uint8]
"""Shape (height, width, 3), uint8, RGB."""
View = tuple[Image, ...]
"""The images of all cameras at one time, in the order of ``IMAGES_OF``."""


@dataclass(frozen=True, slots=True)
class Velocity:
    """A command, or a measured velocity."""

    linear: float = 0.0
    """Forward, m/s."""
    angular: float = 0.0
    """Yaw rate, rad/s, positive to the left."""


STOP = Velocity()


@dataclass(frozen=True, slots=True)
class PathNode:
    """A node (keyframe) of a path."""

    view: View
    """Images at the node."""
    stamp_ns: int
    """Stamp of the images, ns."""
    distance: float
    """Driven distance up to the node, metres: by odometry where there is any, else by the commands."""
    velocities: tuple[tuple[int, Velocity], ...]
    """Commands up to the next node, in order: time after ``stamp_ns``, ns, and the velocity from then on."""
    pose: tuple[float, float, float] | None = None
    """x, y, yaw of odometry, metres and radians; None = the path has none. Followers never use it."""


@dataclass(frozen=True, slots=True)
class RecordedPath:
    """A path as a sequence of nodes, and its cameras."""

    camera: CameraKind
    hfov: float
    """Horizontal field of view of an image, radians; of a fisheye: across its circle."""
    nodes: tuple[PathNode, ...]
    spacing: float = 0.2
    """Distance between nodes, metres."""

    @property
    def length(self) -> float:
        """Length of the path, metres."""
        return self.nodes[-1].distance


@dataclass(frozen=True, slots=True)
class Step:
    """Estimated motion of the robot between two times, not the commanded one."""

    distance: float = 0.0
    """Metres forward."""
    turn: float = 0.0
    """Radians to the left."""


@dataclass(frozen=True, slots=True)
class Place:
    """Place of the robot on the path, by a localiser."""

    index: float
    """Node index with a fraction: 3.5 = half-way between nodes 3 and 4."""
    confidence: float
    """Probability that the robot is within one node of ``index``, 0 to 1; 0 if the images do not fit there."""
    is_lost: bool
    """Whether the images fit nowhere, or at several places."""
    moved: Step = Step()
    """Estimated motion since the previous view."""
    pending: Step = Step()
    """Motion that commands sent before this view will still cause, because of the latency."""


class Policy(Protocol):
    """Computes a velocity from images and the place on the path. One object serves one robot on one path."""

    def reset(self) -> None:
        """Drops all earlier views."""

    def act(self, view: View, stamp_ns: int, place: Place) -> Velocity:
        """Returns the velocity until the next view.

        Args:
            view: the images.
            stamp_ns: their stamp, ns; it grows from call to call.
            place: their place on the path.
        """


@runtime_checkable
class SelfLocalisingPolicy(Policy, Protocol):
    """A policy that localises the robot by itself."""

    @property
    def is_localised(self) -> bool:
        """Whether it did so recently, so that it may drive on where the localiser is lost: beside an obstacle on the path, for instance."""
