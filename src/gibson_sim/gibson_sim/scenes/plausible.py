"""Refuses models whose numbers cannot be meant, before they reach the physics engine, where one NaN spoils the whole world."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from gibson_sim.errors import MeshError, SceneError
from gibson_sim.quoting import quoted
from gibson_sim.robots.rigid import MOVING_TYPES
from gibson_sim.robots.spec import Shape
from gibson_sim.robots.urdf import Inertial, UrdfJoint, UrdfModel
from gibson_sim.scenes.builder import FAR_AWAY
from gibson_sim.scenes.mesh import MeshLoader
from gibson_sim.scenes.sdf_body import MAX_LINKS
from gibson_sim.types import Pose

MAX_MASS = 1e6
"""kg."""
MAX_INERTIA = 1e9
"""kg m^2."""


def check_plausible(model: UrdfModel, loader: MeshLoader) -> None:
    """Checks every number of a model.

    Args:
        model: what somebody wants to load.
        loader: knows how large its meshes are; one that it cannot read is for others to report.

    Raises:
        SceneError: naming the link or joint, the value and what is allowed.
    """
    if len(model.links) > MAX_LINKS:
        raise SceneError(f"{model.path}: has {len(model.links)} links, must be at most {MAX_LINKS}; split it")
    for link in model.links:
        where = f"{model.path}: link {quoted(link.name)}"
        shapes = [(v.shape, v.pose) for v in link.visuals] + [(c.shape, c.pose) for c in link.collisions]
        for shape, pose in shapes:
            _check_place(where, pose)
            _check_shape(where, shape, loader)
        if link.inertial is not None:
            _check_inertial(where, link.inertial)
        if link.friction is not None and not 0.0 <= link.friction < math.inf:
            raise SceneError(f"{where}: friction is {link.friction:g}, must be a finite number, 0 or more")
    for joint in model.joints:
        _check_joint(f"{model.path}: joint {quoted(joint.name)}", joint)


def _check_inertial(where: str, inertial: Inertial) -> None:
    if not 0.0 <= inertial.mass <= MAX_MASS:
        raise SceneError(f"{where}: mass is {inertial.mass:g} kg, must be 0 to {MAX_MASS:g}; is it in grams?")
    for name, value in zip(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), inertial.inertia, strict=True):
        low = 0.0 if name in ("ixx", "iyy", "izz") else -MAX_INERTIA
        if not low <= value <= MAX_INERTIA:
            raise SceneError(f"{where}: {name} is {value:g} kg m^2, must be {low:g} to {MAX_INERTIA:g}")
    _check_place(where, inertial.pose)


def _check_place(where: str, pose: Pose) -> None:
    if not all(abs(c) <= FAR_AWAY for c in pose.position):
        at = ", ".join(f"{c:g}" for c in pose.position)
        raise SceneError(f"{where}: something in it is at ({at}) m, must be within {FAR_AWAY:g} m")


def _check_shape(where: str, shape: Shape, loader: MeshLoader) -> None:
    size, what = shape.size, str(shape.kind)
    if shape.kind == "mesh":
        if not all(map(math.isfinite, size)) or not all(size):
            raise SceneError(f"{where}: scale of a mesh is {size}, the three factors must be finite and not 0")
        try:
            bounds = loader.mesh(Path(shape.mesh)).bounds
        except MeshError:
            return
        x, y, z = (np.abs(bounds).max(axis=0) * np.abs(size)).tolist()
        size, what = (x, y, z), f"mesh {shape.mesh}"
    if not all(0.0 <= s <= FAR_AWAY for s in size):
        raise SceneError(f"{where}: {what} is {max(size):g} m large, must be at most {FAR_AWAY:g} m; is the unit right?")


def _check_joint(where: str, joint: UrdfJoint) -> None:
    if joint.kind not in (*MOVING_TYPES, "fixed"):
        raise SceneError(f"{where}: type {joint.kind} is not simulated; use {', '.join(MOVING_TYPES)} or fixed")
    _check_place(where, joint.pose)
    for name in ("lower", "upper", "effort", "velocity", "damping", "friction"):
        value = getattr(joint, name)
        slows = name in ("damping", "friction")
        if not math.isfinite(value) or (slows and value < 0.0):
            raise SceneError(f"{where}: {name} is {value:g}, must be a finite number{', 0 or more' if slows else ''}")
