"""Arms, grippers and poses of a robot: pure values, whose joints ``load_manipulators`` has found in the URDF."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class GripperSpec:
    """Fingers that open and close together."""

    joints: tuple[str, ...]
    """One for each finger that has a motor; a finger that mimics another is not named."""
    open: float
    """Position of every joint where it is open, radians or metres."""
    closed: float
    """The same where it is closed, with nothing in it."""
    max_effort: float
    """N or N m of each joint: how hard it closes unless a command says less."""

    @property
    def links_apart(self) -> float:
        """How far all joints together move between open and closed: the opening of a parallel gripper, metres."""
        return abs(self.open - self.closed) * len(self.joints)


@dataclass(frozen=True, slots=True)
class ManipulatorSpec:
    """A chain of joints that moves a tool."""

    name: str
    joints: tuple[str, ...]
    """From the base to the tool; each moves what comes after it."""
    tip_link: str
    """Its frame is the tool's centre point: what inverse kinematics and Cartesian commands move."""
    base_link: str
    """Parent of the first joint."""
    gripper: GripperSpec | None = None


@dataclass(frozen=True, slots=True)
class NamedPose:
    """Where some joints are in a pose that has a name."""

    name: str
    joints: tuple[tuple[str, float], ...]
    """Names and positions, radians or metres."""
