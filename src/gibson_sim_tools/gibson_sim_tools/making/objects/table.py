"""Writes the table of objects in docs/objects.md."""

from __future__ import annotations

import math
from collections.abc import Sequence

from gibson_sim_tools.making.objects.model import ObjectJoint, ObjectModel

_HEADER = "| object | class | depth x width x height, m | mass, kg | joints |\n|---|---|---|---|---|"


def objects_table(models: Sequence[ObjectModel]) -> str:
    """Returns a Markdown table of names, classes, sizes, masses and joints."""
    return "\n".join([_HEADER, *(_row(model) for model in models)])


def _row(model: ObjectModel) -> str:
    size = " x ".join(f"{edge:.3f}" for edge in model.size)
    joints = ", ".join(_joint(joint) for joint in model.joints if joint.kind != "fixed") or "none"
    return f"| `{model.name}` | {model.semantic_class} | {size} | {model.mass:.3g} | {joints} |"


def _joint(joint: ObjectJoint) -> str:
    if joint.kind == "prismatic":
        return f"`{joint.name}` {joint.lower:g} to {joint.upper:g} m"
    return f"`{joint.name}` {math.degrees(joint.lower):.0f} to {math.degrees(joint.upper):.0f}°"
