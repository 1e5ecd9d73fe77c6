"""Reads the ``drive`` section of a ``robot.yaml``."""

from __future__ import annotations

import numpy as np

from gibson_sim.errors import RobotError
from gibson_sim.robots.drive_spec import DriveSpec
from gibson_sim.robots.settings import Settings
from gibson_sim.robots.urdf import UrdfModel

_LIMIT_KEYS = ("max_linear", "max_angular", "max_linear_acceleration", "max_angular_acceleration", "max_wheel_torque")
_DRIVE_KEYS = ("type", "left_joint", "right_joint", "wheel_radius", "wheel_separation", *_LIMIT_KEYS)


def read_drive(robot: Settings, model: UrdfModel) -> DriveSpec | None:
    """Returns the drive; None = the file gives none."""
    settings = robot.section("drive")
    if settings is None:
        return None
    settings.check_keys(_DRIVE_KEYS)
    kind = settings.text("type")
    if kind != "differential":
        raise RobotError(f"{settings.where}: type is {kind!r}, must be 'differential'")
    transforms = model.transforms()
    left, right = (model.joint(settings.text(key)) for key in ("left_joint", "right_joint"))
    signs, hubs = [], []
    for joint in (left, right):
        T_root_wheel = transforms[joint.child]
        across = float((T_root_wheel[:3, :3] @ np.array(joint.axis))[1])
        if joint.kind != "continuous" or abs(across) < 0.99:
            raise RobotError(
                f"{model.path}: joint {joint.name!r} cannot drive: it must be continuous, with its axis along y of {model.root}"
            )
        signs.append(1.0 if across > 0 else -1.0)
        hubs.append(T_root_wheel[:3, 3])
    given = settings.numbers(("wheel_radius", "wheel_separation", *_LIMIT_KEYS))
    given.setdefault("wheel_separation", float(hubs[0][1] - hubs[1][1]))
    if given["wheel_separation"] <= 0:
        raise RobotError(f"{settings.where}: {left.name!r} is not to the left (+y) of {right.name!r}; were they swapped?")
    if "wheel_radius" not in given:
        given["wheel_radius"] = _wheel_radius(model, left.child)
        other = _wheel_radius(model, right.child)
        if abs(other - given["wheel_radius"]) > 1e-6:
            raise RobotError(
                f"{model.path}: the wheels have radii {given['wheel_radius']:g} and {other:g} m; give drive.wheel_radius"
            )
    return DriveSpec(left.name, right.name, **given, left_sign=signs[0], right_sign=signs[1])


def _wheel_radius(model: UrdfModel, link_name: str) -> float:
    """Returns the radius of the largest sphere or cylinder of the link: collision shapes first, else what is drawn."""
    link = model.link(link_name)
    for shapes in ([c.shape for c in link.collisions], [v.shape for v in link.visuals]):
        radii = [shape.size[0] for shape in shapes if shape.kind in ("sphere", "cylinder")]
        if radii:
            return max(radii)
    raise RobotError(
        f"{model.path}: link {link_name!r} has no sphere or cylinder to read the wheel's radius from; give drive.wheel_radius"
    )
