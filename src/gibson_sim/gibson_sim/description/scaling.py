"""Scales URDF models. Pure."""

from __future__ import annotations

from dataclasses import replace

from gibson_sim.description.mimic import Mimic
from gibson_sim.description.shapes import Shape
from gibson_sim.description.urdf import Inertial, UrdfJoint, UrdfLink, UrdfModel
from gibson_sim.types import Pose, Vec3


def scaled_model(model: UrdfModel, factor: float) -> UrdfModel:
    """Returns the model with all lengths scaled by ``factor`` at constant density: mass scales with the third power.

    The travel of prismatic joints scales with ``factor``; angles do not change. Damping and friction scale with mass and inertia, so that joints
    come to rest as before.
    """
    if factor == 1.0:
        return model
    links = tuple(_link(link, factor) for link in model.links)
    factors = {joint.name: factor if joint.kind == "prismatic" else 1.0 for joint in model.joints}
    return replace(model, links=links, joints=tuple(_joint(joint, factor, factors) for joint in model.joints))


def _link(link: UrdfLink, factor: float) -> UrdfLink:
    inertial = link.inertial
    if inertial is not None:
        ixx, ixy, ixz, iyy, iyz, izz = (moment * factor**5 for moment in inertial.inertia)
        inertial = Inertial(inertial.mass * factor**3, _pose(inertial.pose, factor), (ixx, ixy, ixz, iyy, iyz, izz))
    return replace(
        link,
        visuals=tuple(replace(v, shape=_shape(v.shape, factor), pose=_pose(v.pose, factor)) for v in link.visuals),
        collisions=tuple(replace(c, shape=_shape(c.shape, factor), pose=_pose(c.pose, factor)) for c in link.collisions),
        inertial=inertial,
    )


def _joint(joint: UrdfJoint, factor: float, factors: dict[str, float]) -> UrdfJoint:
    travel_factor = factors[joint.name]
    # The damping of a prismatic joint (N s/m) scales with the mass, that of a hinge (N m s/rad) with the inertia.
    damping = joint.damping * factor ** (3 if joint.kind == "prismatic" else 5)
    # The friction of a prismatic joint (N) scales with mass times length, that of a hinge (N m) with the inertia.
    friction = joint.friction * factor ** (4 if joint.kind == "prismatic" else 5)
    pose, lower, upper = _pose(joint.pose, factor), joint.lower * travel_factor, joint.upper * travel_factor
    return replace(
        joint,
        pose=pose,
        lower=lower,
        upper=upper,
        damping=damping,
        mimic=_mimic(joint, travel_factor, factors),
        friction=friction,
    )


def _mimic(joint: UrdfJoint, travel_factor: float, factors: dict[str, float]) -> Mimic | None:
    """Returns the mimic of a joint whose travel is scaled by ``stretch``, and that of its leader by its factor in ``factors``."""
    if joint.mimic is None:
        return None
    multiplier = joint.mimic.multiplier * travel_factor / factors[joint.mimic.leader]
    return replace(joint.mimic, multiplier=multiplier, offset=joint.mimic.offset * travel_factor)


def _shape(shape: Shape, factor: float) -> Shape:
    x, y, z = shape.size
    return replace(shape, size=(x * factor, y * factor, z * factor))


def _pose(pose: Pose, factor: float) -> Pose:
    x, y, z = pose.position
    position: Vec3 = (x * factor, y * factor, z * factor)
    return replace(pose, position=position)
