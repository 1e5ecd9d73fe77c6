"""Reads the axis of an SDF joint: its type, direction, limits, dynamics and leader."""

from __future__ import annotations

import math
from dataclasses import dataclass

from gibson_sim.description.omissions import OmissionKind
from gibson_sim.description.urdf_model import Mimic
from gibson_sim.quoting import quoted
from gibson_sim.scenes.builder import SceneBuilder
from gibson_sim.scenes.sdf.elements import Element, is_true, number, numbers, text_of
from gibson_sim.types import Vec3

_KINDS = {"revolute": "revolute", "continuous": "continuous", "prismatic": "prismatic", "fixed": "fixed"}
"""Type of an SDF joint -> kind of a ``UrdfJoint``."""
_MAX_LIMIT = 1e6
"""Joint limit, radians or metres, above which a joint counts as unlimited: files contain 1e16 and more."""


@dataclass(frozen=True, slots=True)
class JointAxis:
    """Type, axis, limits and dynamics of a joint, in the units of ``UrdfJoint``."""

    kind: str
    xyz: Vec3 = (0.0, 0.0, 1.0)
    """Unit vector in the frame of the joint, unless ``expressed_in`` or ``parent_model_frame`` names another frame."""
    expressed_in: str = ""
    """Frame of the axis (SDF 1.7 and later); empty = not given."""
    parent_model_frame: bool | None = None
    """Value of <use_parent_model_frame>; None = not given."""
    lower: float = 0.0
    upper: float = -1.0
    effort: float = 0.0
    velocity: float = 0.0
    damping: float = 0.0
    friction: float = 0.0
    mimic: Mimic | None = None
    """Leader that the joint follows, by its name in the scope of the joint."""

    def in_model_frame(self, version: tuple[int, ...]) -> bool:
        """Returns whether the axis is in the frame of the model: by <use_parent_model_frame> if given, else in SDF 1.4 and older."""
        if self.parent_model_frame is not None:
            return self.parent_model_frame
        return bool(version) and version <= (1, 4)


def read_axis(element: Element, name: str, builder: SceneBuilder) -> JointAxis:
    """Returns the axis of a <joint>; a fixed axis, with a warning, if the joint type is not simulated."""
    kind = _KINDS.get(element.get("type", ""))
    where = f"joint {name}"
    if kind is None:
        builder.warn(f"{where}: type {quoted(element.get('type', ''))} is not simulated; the joint is fixed")
        return JointAxis("fixed")
    axis = element.find("axis")
    if kind == "fixed" or axis is None:
        if kind != "fixed":
            builder.warn(f"{where}: has no <axis>; the z axis of the joint is used")
        return JointAxis("continuous" if kind == "revolute" else kind)
    xyz = axis.find("xyz")
    text = "0 0 1" if xyz is None else (xyz.text or "").strip()
    values = numbers(text, (3,)) or [0.0, 0.0, 0.0]
    length = math.sqrt(sum(c * c for c in values))
    if length < 1e-9:
        builder.warn(f"{where}: axis {quoted(text)} is not a direction; z is used", OmissionKind.INVALID)
        values, length = [0.0, 0.0, 1.0], 1.0
    in_model_frame = text_of(axis, "use_parent_model_frame")
    lower = _limit(axis, "limit/lower", -math.inf, where, builder)
    upper = _limit(axis, "limit/upper", math.inf, where, builder)
    if lower > upper:
        builder.warn(f"{where}: limits are {lower:g} to {upper:g}, must be lower to upper", OmissionKind.INVALID)
    unlimited = lower < -_MAX_LIMIT and upper > _MAX_LIMIT
    if unlimited or kind == "continuous":
        kind = "continuous" if kind == "revolute" else kind
        lower, upper = 0.0, -1.0
    lower, upper = max(lower, -_MAX_LIMIT), min(upper, _MAX_LIMIT)
    effort, velocity = (_limit(axis, f"limit/{key}", 0.0, where, builder) for key in ("effort", "velocity"))
    damping, friction = (_limit(axis, f"dynamics/{key}", 0.0, where, builder) for key in ("damping", "friction"))
    stiffness = _limit(axis, "dynamics/spring_stiffness", 0.0, where, builder)
    if stiffness:
        rest = _limit(axis, "dynamics/spring_reference", 0.0, where, builder)
        builder.warn(f"{where}: its spring, {stiffness:g} per unit about {rest:g}, is not simulated; nothing pulls it back")
    return JointAxis(
        kind,
        (values[0] / length, values[1] / length, values[2] / length),
        "" if xyz is None else xyz.get("expressed_in", "").strip(),
        is_true(in_model_frame) if in_model_frame else None,
        lower,
        upper,
        # A negative or infinite limit means no limit.
        effort if 0.0 < effort < _MAX_LIMIT else 0.0,
        velocity if 0.0 < velocity < _MAX_LIMIT else 0.0,
        damping if math.isfinite(damping) else 0.0,
        friction if math.isfinite(friction) else 0.0,
        _mimic(axis, where, builder),
    )


def _mimic(axis: Element, where: str, builder: SceneBuilder) -> Mimic | None:
    """Returns the <mimic> of an axis; None if it has none, or names none."""
    element = axis.find("mimic")
    if element is None:
        return None
    leader = element.get("joint", "").strip()
    if not leader:
        builder.warn(f"{where}: its <mimic> names no joint; left out", OmissionKind.INVALID)
        return None
    if element.get("axis", "axis").strip() == "axis2":
        builder.warn(f"{where}: mimics axis2 of {quoted(leader)}, which is not simulated; it moves freely")
        return None
    multiplier, offset, reference = (
        _limit(element, key, default, where, builder)
        for key, default in (("multiplier", 1.0), ("offset", 0.0), ("reference", 0.0))
    )
    # SDF: position = multiplier * (leader - reference) + offset.
    return Mimic(leader, multiplier, offset - multiplier * reference)


def _limit(axis: Element, path: str, default: float, where: str, builder: SceneBuilder) -> float:
    """Returns the number in an element, which may be infinite; the default if it is missing or, with a warning, not a number."""
    text = (axis.findtext(path) or "").strip()
    if not text:
        return default
    try:
        value = number(text)
    except ValueError:
        value = math.nan
    if math.isnan(value):
        builder.warn(f"{where}: <{path.rpartition('/')[2]}> is {quoted(text)}, must be a number", OmissionKind.INVALID)
        return default
    return value
