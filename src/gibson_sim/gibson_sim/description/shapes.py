"""Shapes, and how they look: what robots, bodies and scenes are drawn from. Pure values."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

from gibson_sim.errors import ConfigError
from gibson_sim.quoting import quoted
from gibson_sim.types import Pose, Rgba, Vec3

ShapeKind = Literal["mesh", "box", "sphere", "cylinder"]


@dataclass(frozen=True, slots=True)
class Shape:
    """A piece of geometry in its own frame, z up, centred (primitives) or as its file has it (meshes)."""

    kind: ShapeKind
    size: Vec3 = (1.0, 1.0, 1.0)
    """mesh: scale factors along x, y, z; box: edge lengths; sphere: (radius, 0, 0); cylinder about z: (radius, length, 0); m."""
    mesh: str = ""
    """Absolute path of the mesh file; empty for primitives."""


PatternKind = Literal["noise", "stripes", "checker", "image"]
PATTERN_KINDS: tuple[PatternKind, ...] = ("noise", "stripes", "checker", "image")


@dataclass(frozen=True, slots=True)
class Pattern:
    """A texture made of a few numbers, laid over a surface in metres, along the axes of its link (or of the world)."""

    kind: PatternKind = "noise"
    seed: int = 0
    """noise: decides every pixel."""
    colors: tuple[Vec3, Vec3] = ((0.2, 0.2, 0.2), (0.8, 0.8, 0.8))
    """sRGB, 0 to 1; image: not used."""
    size: float = 0.5
    """Metres after which it repeats; stripes and checkers have four pairs of colours in it."""
    image: str = ""
    """kind image: absolute path of the file."""

    def __post_init__(self) -> None:
        if self.kind not in PATTERN_KINDS:
            raise ConfigError(f"pattern is {quoted(self.kind)}, must be one of {', '.join(PATTERN_KINDS)}")
        if not (math.isfinite(self.size) and self.size > 0.0):
            raise ConfigError(f"size of a pattern is {quoted(self.size)} m, must be a finite number above 0")
        if (self.kind == "image") != bool(self.image):
            raise ConfigError(
                f"a pattern of kind {quoted(self.kind)} has image {quoted(self.image)}; kind image needs a file, others have none"
            )


@dataclass(frozen=True, slots=True)
class Appearance:
    """What changes in the materials of a visual. Where it is solid, and thus depth, labels and normals, never changes."""

    hue: float = 0.0
    """Turns all colours, 1 = once around."""
    saturation: float = 1.0
    """Factor: 0 = grey."""
    value: float = 1.0
    """Factor on the light: 0 = black."""
    pattern: Pattern | None = None
    """Replaces the colours of the texture, but not its opacity; None = they stay."""
    metallic: float | None = None
    """Replaces it, 0 to 1, or None."""
    roughness: float | None = None
    """Replaces it, 0 to 1, or None."""

    @property
    def is_tint(self) -> bool:
        """Whether colours change at all, other than by a pattern."""
        return (self.hue, self.saturation, self.value) != (0.0, 1.0, 1.0)


@dataclass(frozen=True, slots=True)
class VisualSpec:
    """A shape to be drawn."""

    name: str
    """Unique in the scene."""
    link: str
    """Link that it is fixed to, as in ``SceneState.links``; empty = the world, so it never moves."""
    shape: Shape
    pose: Pose = field(default_factory=Pose)
    """T_link_visual."""
    color: Rgba | None = None
    """Replaces the materials of the file (sRGB and alpha, each 0 to 1); None = as the file says."""
    semantic_class: str = ""
    """Class name; empty = unlabelled."""
    appearance: Appearance | None = None
    """Changes to the materials; None = none."""
