"""What the parts of the package hand to each other: images, nodes of a path, velocities, places on the path, and what a policy is.

Frames and units: REP-103; velocities in the frame of the robot, x forward, positive yaw rate to the left. No ROS here: the nodes, and the
benchmarks that run without ROS, use the same classes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

CameraKind = Literal["pinhole", "fisheye_pair"]
"""One pinhole camera that looks ahead; or two fisheyes of 180 degrees, ahead and back, that see all around."""
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
    """One place of a path."""

    view: View
    """What the cameras saw there."""
    stamp_ns: int
    """Stamp of the images, ns."""
    distance: float
    """Length of the path up to here, metres: by odometry where there is any, else by the commands."""
    velocities: tuple[tuple[int, Velocity], ...]
    """What was driven from here to the next node: (time after ``stamp_ns`` in ns, velocity from then on), in order."""
    pose: tuple[float, float, float] | None = None
    """x, y, yaw of odometry, metres and radians; None = the path has none. Followers never use it."""


@dataclass(frozen=True, slots=True)
class RecordedPath:
    """A path as a chain of places, and how its cameras see."""

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
    """A small motion of the robot, as it is believed to be, not as it was commanded."""

    distance: float = 0.0
    """Metres forward."""
    turn: float = 0.0
    """Radians to the left."""


@dataclass(frozen=True, slots=True)
class Place:
    """Where on the path the robot is, as a localiser believes."""

    index: float
    """Node, with a fraction: 3.5 = half-way between nodes 3 and 4."""
    confidence: float
    """Share of the belief within one node of ``index``, 0 to 1; 0 if the images do not fit there."""
    is_lost: bool
    """Whether the images fit nowhere, or to several places alike."""
    moved: Step = Step()
    """What the robot made since the view before."""
    pending: Step = Step()
    """What it will still make after this view by commands that were sent already; they take a while."""


class Policy(Protocol):
    """Turns what the cameras see, and where on the path that is, into a velocity. One object serves one robot on one path."""

    def reset(self) -> None:
        """Forgets all earlier views."""

    def act(self, view: View, stamp_ns: int, place: Place) -> Velocity:
        """Returns the velocity until the next view.

        Args:
            view: what the cameras see.
            stamp_ns: stamp of the images, ns; it grows from call to call.
            place: where on the path that is.
        """


@runtime_checkable
class SelfLocalisingPolicy(Policy, Protocol):
    """A policy that itself sees where on the path the robot is."""

    @property
    def is_localised(self) -> bool:
        """Whether it saw that lately, so that it may drive on where the localiser is lost: beside what stands on the path, for instance."""
