"""Reads the kind, axis and limits of an SDF joint."""

from __future__ import annotations

import math
from dataclasses import dataclass

from gibson_sim.quoting import quoted
from gibson_sim.robots.omissions import OmissionKind
from gibson_sim.scenes.builder import SceneBuilder
from gibson_sim.scenes.sdf_geometry import Element, numbers
from gibson_sim.types import Vec3

_KINDS = {"revolute": "revolute", "continuous": "continuous", "prismatic": "prismatic", "fixed": "fixed"}
_ENDLESS = 1e6
"""Limits beyond this are none: files write 1e16 and more."""


@dataclass(frozen=True, slots=True)
class JointAxis:
    """How a joint moves; kind and limits are those of ``UrdfJoint``."""

    kind: str
    xyz: Vec3 = (0.0, 0.0, 1.0)
    """Unit vector, in the frame of the joint unless another one is named."""
    expressed_in: str = ""
    """Frame of the axis (SDF 1.7 and later)."""
    parent_model_frame: bool | None = None
    """What <use_parent_model_frame> says; None = nothing."""
    lower: float = 0.0
    upper: float = -1.0
    effort: float = 0.0
    velocity: float = 0.0
    damping: float = 0.0
    friction: float = 0.0

    def in_model_frame(self, version: tuple[int, ...]) -> bool:
        """Returns whether the axis is in the frame of the model: asked for, or written in SDF 1.4 or older."""
        if self.parent_model_frame is not None:
            return self.parent_model_frame
        return bool(version) and version <= (1, 4)


def joint_axis(element: Element, name: str, builder: SceneBuilder) -> JointAxis:
    """Returns the axis of a <joint>; of a kind that is not simulated, a fixed one after a warning."""
    kind = _KINDS.get(element.get("type", ""))
    where = f"joint {name}"
    if kind is None:
        builder.warn(f"{where}: type {quoted(element.get('type', ''))} is not simulated; it does not move")
        return JointAxis("fixed")
    axis = element.find("axis")
    if kind == "fixed" or axis is None:
        if kind != "fixed":
            builder.warn(f"{where}: has no <axis>; it turns about z of the joint")
        return JointAxis("continuous" if kind == "revolute" else kind)
    xyz = axis.find("xyz")
    text = "0 0 1" if xyz is None else (xyz.text or "").strip()
    values = numbers(text, (3,)) or [0.0, 0.0, 0.0]
    length = math.sqrt(sum(c * c for c in values))
    if length < 1e-9:
        builder.warn(f"{where}: axis {quoted(text)} is no direction; z is used", OmissionKind.INVALID)
        values, length = [0.0, 0.0, 1.0], 1.0
    asked = (axis.findtext("use_parent_model_frame") or "").strip().lower()
    lower = _number(axis, "limit/lower", -math.inf, where, builder)
    upper = _number(axis, "limit/upper", math.inf, where, builder)
    if lower > upper:
        builder.warn(f"{where}: limits are {lower:g} to {upper:g}, must be lower to upper", OmissionKind.INVALID)
    endless = lower < -_ENDLESS and upper > _ENDLESS
    if endless or kind == "continuous":
        kind = "continuous" if kind == "revolute" else kind
        lower, upper = 0.0, -1.0
    lower, upper = max(lower, -_ENDLESS), min(upper, _ENDLESS)
    effort, velocity = (_number(axis, f"limit/{key}", 0.0, where, builder) for key in ("effort", "velocity"))
    damping, friction = (_number(axis, f"dynamics/{key}", 0.0, where, builder) for key in ("damping", "friction"))
    return JointAxis(
        kind,
        (values[0] / length, values[1] / length, values[2] / length),
        "" if xyz is None else xyz.get("expressed_in", "").strip(),
        asked in ("1", "true") if asked else None,
        lower,
        upper,
        # A negative one, or infinity, means that there is none.
        effort if 0.0 < effort < _ENDLESS else 0.0,
        velocity if 0.0 < velocity < _ENDLESS else 0.0,
        damping if math.isfinite(damping) else 0.0,
        friction if math.isfinite(friction) else 0.0,
    )


def _number(axis: Element, path: str, default: float, where: str, builder: SceneBuilder) -> float:
    """Returns a number, which may be infinite."""
    text = (axis.findtext(path) or "").strip()
    if not text:
        return default
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if math.isnan(value):
        builder.warn(f"{where}: <{path.rpartition('/')[2]}> is {quoted(text)}, must be a number", OmissionKind.INVALID)
        return default
    return value
