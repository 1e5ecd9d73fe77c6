"""Makes a model larger or smaller. Pure."""

from __future__ import annotations

from dataclasses import replace

from gibson_sim.description.mimic import Mimic
from gibson_sim.description.shapes import Shape
from gibson_sim.description.urdf import Inertial, UrdfJoint, UrdfLink, UrdfModel
from gibson_sim.types import Pose, Vec3


def scaled_model(model: UrdfModel, factor: float) -> UrdfModel:
    """Returns the model with all lengths times ``factor`` and its density as it was: mass grows with the third power.

    What slides does so by ``factor`` times as far; angles stay. Damping and friction grow with mass and inertia, so things come to rest as before.
    """
    if factor == 1.0:
        return model
    links = tuple(_link(link, factor) for link in model.links)
    leads = {joint.name: factor if joint.kind == "prismatic" else 1.0 for joint in model.joints}
    return replace(model, links=links, joints=tuple(_joint(joint, factor, leads) for joint in model.joints))


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


def _joint(joint: UrdfJoint, factor: float, leads: dict[str, float]) -> UrdfJoint:
    along = leads[joint.name]
    # N s/m of a slide goes with the mass, N m s/rad of a hinge with the inertia.
    damping = joint.damping * factor ** (3 if joint.kind == "prismatic" else 5)
    # N of a slide goes with the mass and the way, N m of a hinge with the inertia.
    friction = joint.friction * factor ** (4 if joint.kind == "prismatic" else 5)
    pose, lower, upper = _pose(joint.pose, factor), joint.lower * along, joint.upper * along
    return replace(
        joint, pose=pose, lower=lower, upper=upper, damping=damping, mimic=_mimic(joint, along, leads), friction=friction
    )


def _mimic(joint: UrdfJoint, along: float, leads: dict[str, float]) -> Mimic | None:
    """Returns what it follows, where its own motion is ``along`` times as far and that of its leader as ``leads`` says."""
    if joint.mimic is None:
        return None
    multiplier = joint.mimic.multiplier * along / leads[joint.mimic.leader]
    return replace(joint.mimic, multiplier=multiplier, offset=joint.mimic.offset * along)


def _shape(shape: Shape, factor: float) -> Shape:
    x, y, z = shape.size
    return replace(shape, size=(x * factor, y * factor, z * factor))


def _pose(pose: Pose, factor: float) -> Pose:
    x, y, z = pose.position
    position: Vec3 = (x * factor, y * factor, z * factor)
    return replace(pose, position=position)
