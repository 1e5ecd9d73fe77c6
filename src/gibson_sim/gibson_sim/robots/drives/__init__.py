"""Kinematics of robots that drive: one interface, one file for each kind of drive. Pure: no physics engine, no ROS."""

from __future__ import annotations

from gibson_sim.robots.drive_spec import AckermannSpec, DifferentialSpec, DriveSpec, PlanarSpec
from gibson_sim.robots.drives.ackermann import AckermannDrive
from gibson_sim.robots.drives.base import BaseServo, Drive, DriveJoint, DriveTargets, PlanarVelocity, Response, active_command
from gibson_sim.robots.drives.differential import DifferentialDrive
from gibson_sim.robots.drives.omni import OmniDrive, PlanarDrive

__all__ = ["BaseServo", "Drive", "DriveJoint", "DriveTargets", "PlanarVelocity", "Response", "active_command", "make_drive"]


def make_drive(spec: DriveSpec) -> Drive:
    """Returns a drive at rest, at the origin of its odom frame."""
    if isinstance(spec, DifferentialSpec):
        return DifferentialDrive(spec)
    if isinstance(spec, AckermannSpec):
        return AckermannDrive(spec)
    return PlanarDrive(spec) if isinstance(spec, PlanarSpec) else OmniDrive(spec)
