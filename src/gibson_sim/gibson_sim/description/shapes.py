"""Shapes and visuals of robots, bodies and scenes, and their appearance. Pure values."""

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
    """A geometry in its own frame, z up, centred (primitives) or as in its file (meshes)."""

    kind: ShapeKind
    size: Vec3 = (1.0, 1.0, 1.0)
    """mesh: scale factors along x, y, z; box: edge lengths; sphere: (radius, 0, 0); cylinder about z: (radius, length, 0); m."""
    mesh: str = ""
    """Absolute path of the mesh file; empty for primitives."""


PatternKind = Literal["noise", "stripes", "checker", "image"]
PATTERN_KINDS: tuple[PatternKind, ...] = ("noise", "stripes", "checker", "image")


@dataclass(frozen=True, slots=True)
class Pattern:
    """A procedural texture, or an image, mapped in metres along the axes of the link (or of the world)."""

    kind: PatternKind = "noise"
    seed: int = 0
    """noise: seed of its pixels."""
    colors: tuple[Vec3, Vec3] = ((0.2, 0.2, 0.2), (0.8, 0.8, 0.8))
    """sRGB, 0 to 1; image: not used."""
    size: float = 0.5
    """Period, metres; stripes and checkers have four pairs of colours in it."""
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
    """Changes to the materials of a visual. Depth, labels and normals never change, since opacity does not."""

    hue: float = 0.0
    """Rotation of the hue of all colours, 1 = a full circle."""
    saturation: float = 1.0
    """Factor on the saturation: 0 = grey."""
    value: float = 1.0
    """Factor on the brightness: 0 = black."""
    pattern: Pattern | None = None
    """Replaces the colours of the texture, but not its opacity; None = no change."""
    metallic: float | None = None
    """Replaces the metalness, 0 to 1; None = no change."""
    roughness: float | None = None
    """Replaces the roughness, 0 to 1; None = no change."""

    @property
    def is_tint(self) -> bool:
        """Whether colours change other than by a pattern."""
        return (self.hue, self.saturation, self.value) != (0.0, 1.0, 1.0)


@dataclass(frozen=True, slots=True)
class VisualSpec:
    """A shape to be drawn."""

    name: str
    """Unique in the scene."""
    link: str
    """Link that it is fixed to, as in ``SceneState.links``; empty = the world."""
    shape: Shape
    pose: Pose = field(default_factory=Pose)
    """T_link_visual."""
    color: Rgba | None = None
    """Replaces the materials of the file (sRGB and alpha, each 0 to 1); None = as the file says."""
    semantic_class: str = ""
    """Class name; empty = unlabelled."""
    appearance: Appearance | None = None
    """Changes to the materials; None = none."""
