"""Shapes and visuals of robots, bodies and scenes, and their appearance. Pure values."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

from gibson_sim.errors import ConfigError
from gibson_sim.quoting import quoted
from gibson_sim.types import Pose, Rgba, Vec3

ShapeKind = Literal["mesh", "box", "sphere", "cylinder", "capsule", "ellipsoid", "cone"]
ROUND_KINDS: tuple[ShapeKind, ...] = ("sphere", "cylinder", "capsule")
"""Kinds that roll: their first size is their radius about z."""


@dataclass(frozen=True, slots=True)
class Shape:
    """A geometry in its own frame, z up, with the origin at the centre (primitives) or as in the file (meshes)."""

    kind: ShapeKind
    size: Vec3 = (1.0, 1.0, 1.0)
    """Size: mesh: scale factors along x, y, z; box: edge lengths; sphere: (radius, 0, 0); ellipsoid: radii along x, y, z; about z, m:
    cylinder and cone (base down, origin halfway up): (radius, length, 0); capsule: (radius, length without its half spheres, 0)."""
    mesh: str = ""
    """Absolute path of the mesh file; empty for primitives."""


PatternKind = Literal["noise", "stripes", "checker", "image"]
PATTERN_KINDS: tuple[PatternKind, ...] = ("noise", "stripes", "checker", "image")


@dataclass(frozen=True, slots=True)
class Pattern:
    """A procedural texture, or an image, mapped in metres along the axes of the link (or of the world)."""

    kind: PatternKind = "noise"
    seed: int = 0
    """Seed of the pixels of kind noise."""
    colors: tuple[Vec3, Vec3] = ((0.2, 0.2, 0.2), (0.8, 0.8, 0.8))
    """Two colours, sRGB, 0 to 1; not used by kind image."""
    size: float = 0.5
    """Period, metres; a period of stripes and checkers has four pairs of colours."""
    image: str = ""
    """Absolute path of the file of kind image; empty for other kinds."""

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
    """Changes to the materials of a visual. They do not change opacity, and therefore not depth, labels and normals."""

    hue: float = 0.0
    """Rotation of the hue of all colours, 1 = a full circle."""
    saturation: float = 1.0
    """Factor on the saturation: 0 = grey."""
    value: float = 1.0
    """Factor on the brightness: 0 = black."""
    pattern: Pattern | None = None
    """Pattern that replaces the colours of the texture, but not its opacity; None = no change."""
    metallic: float | None = None
    """Metalness, 0 to 1; None = no change."""
    roughness: float | None = None
    """Roughness, 0 to 1; None = no change."""

    @property
    def is_tint(self) -> bool:
        """Whether hue, saturation or value changes."""
        return (self.hue, self.saturation, self.value) != (0.0, 1.0, 1.0)


@dataclass(frozen=True, slots=True)
class VisualSpec:
    """A visual: a shape that is drawn."""

    name: str
    """Name, unique in the scene."""
    link: str
    """Link that it is fixed to, as in ``SceneState.links``; empty = the world."""
    shape: Shape
    pose: Pose = field(default_factory=Pose)
    """T_link_visual."""
    color: Rgba | None = None
    """Colour that replaces the materials of the file, sRGB and alpha, each 0 to 1; None = the materials of the file."""
    semantic_class: str = ""
    """Semantic class; empty = unlabelled."""
    appearance: Appearance | None = None
    """Changes to the materials; None = none."""
