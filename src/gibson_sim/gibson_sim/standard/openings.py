"""How far doors and drawers are open, from the limits and positions of their joints. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

_OPENING_TOLERANCE = 0.02
"""Tolerance of a requested opening, as a fraction of the joint's range."""
_SPEED_TOLERANCE = 0.02
"""Speed below which a joint counts as at rest, rad/s or m/s: a moving one would bounce off its stop."""
BLOCKED_S = 8.0
"""Time after which a joint that does not reach its opening counts as blocked, s of simulation time."""
_HANDLES = ("handle", "lever", "knob")
"""Suffixes of the names of joints that belong to handles, not to doors."""


@dataclass(frozen=True, slots=True)
class JointOpening:
    """State and limits of a joint, rad or m."""

    position: float
    lower: float
    upper: float
    velocity: float

    @property
    def closed(self) -> float:
        """Closed position: 0, or the limit that is closest to 0."""
        return min(max(0.0, self.lower), self.upper)

    @property
    def range(self) -> float:
        """Difference between open and closed position; negative for a joint that opens in the negative direction."""
        return max(self.upper - self.closed, self.lower - self.closed, key=abs)

    @property
    def opening(self) -> float:
        """Opening as a fraction of the range, 0 = closed, 1 = open."""
        return (self.position - self.closed) / self.range

    def position_at(self, opening: float) -> float:
        """Returns the position of an opening."""
        return self.closed + opening * self.range

    def has_reached(self, opening: float) -> bool:
        """Returns whether the joint rests at an opening."""
        return abs(self.opening - opening) < _OPENING_TOLERANCE and abs(self.velocity) < _SPEED_TOLERANCE


def joint_openings(joints: Iterable[tuple[str, Mapping[str, float]]]) -> dict[str, JointOpening]:
    """Returns the joints of bodies that have limits, except handles.

    Args:
        joints: name, ``<body>/<joint>``, and values of each joint: position, velocity, lower, upper; any of them may be missing.
    """
    found = {}
    for name, values in joints:
        if name.endswith(_HANDLES) or not {"position", "lower", "upper"} <= values.keys():
            continue
        joint = JointOpening(values["position"], values["lower"], values["upper"], values.get("velocity", 0.0))
        if math.isfinite(joint.opening if joint.range else math.nan):
            found[name] = joint
    return found
