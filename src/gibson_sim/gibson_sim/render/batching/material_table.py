"""Materials and appearances of a scene as rows of the arrays that shaders read. No OpenGL.

``MaterialTable`` collects the rows. An appearance changes a material in two ways: ``apply_appearance`` replaces parameters of the
material; shaders apply tints of textures (``tint_matrix``) and patterns (``pattern_pictures``).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.description.shapes import Appearance, Pattern
from gibson_sim.formats.image_header import MAX_IMAGE_BYTES
from gibson_sim.formats.mesh import F64, Material
from gibson_sim.formats.textures import Warn, decode_image
from gibson_sim.geometry.colours import LUMINANCE, linear_from_srgb, srgb8_from_linear, srgb_from_linear
from gibson_sim.reading import read_file
from gibson_sim.render.batching.scene_geometry import APPEARANCE, MATERIAL, PLAIN_APPEARANCE

OPAQUE_ALPHA = 0.9
"""Smallest alpha at which a blended material is drawn as opaque, so that it has a depth."""
PATTERN_PX = 256
"""Side of a pattern image, pixels."""
_CELLS = 8
"""Number of checker cells or stripes along one side; an even number repeats without a seam."""


class MaterialTable:
    """Rows of ``MATERIAL``, each with its row of ``APPEARANCE``."""

    def __init__(self, appearances: Sequence[Appearance], warn: Callable[[str], None]) -> None:
        self.rows: dict[tuple[tuple[float, ...], tuple[float, ...]], int] = {}
        patterns = list(dict.fromkeys(appearance.pattern for appearance in appearances if appearance.pattern is not None))
        self._layers, self.patterns = pattern_pictures(patterns, warn)

    def row(self, material: Material, appearance: Appearance | None) -> int:
        """Returns the row number of a material with an appearance."""
        modified = material if appearance is None else apply_appearance(material, appearance)
        linear = linear_from_srgb(modified.base_color[:3]).tolist()
        # Metalness and roughness of an appearance replace those of a map instead of scaling them.
        from_map = [
            float(appearance is None or value is None)
            for value in (appearance and appearance.metallic, appearance and appearance.roughness)
        ]
        values = (
            *linear, modified.base_color[3],
            modified.metallic, modified.roughness, min(max(opaque_alpha(modified), 0.0), 2.0), float(modified.unlit),
            *modified.emissive, 0.0,
            0.0 if modified.normal_texture is None else modified.normal_scale, modified.occlusion_strength, *from_map,
        )  # fmt: skip
        return self.rows.setdefault((values, self._appearance(material, appearance)), len(self.rows))

    def _appearance(self, material: Material, appearance: Appearance | None) -> tuple[float, ...]:
        if appearance is None or not is_drawn(material, appearance):
            return ()
        layer, size = -1, 1.0
        colors: tuple[tuple[float, ...], tuple[float, ...]] = ((0.0,) * 3, (1.0,) * 3)
        if appearance.pattern is not None:
            layer, size, colors = self._layers[appearance.pattern], appearance.pattern.size, pattern_colors(appearance.pattern)
        first, second = linear_from_srgb(colors).tolist()
        tint = np.hstack([tint_matrix(appearance), np.zeros((3, 1))])
        return (*tint.ravel().tolist(), *first, float(layer), *second, 1.0 / size)

    def materials(self) -> NDArray[np.void]:
        """Returns (M,) of ``MATERIAL``."""
        return np.array([v for v, _ in self.rows], dtype=np.float32).reshape(-1, 16).view(MATERIAL)[:, 0]

    def appearances(self) -> NDArray[np.void]:
        """Returns (M,) of ``APPEARANCE``, or (0,) if there are none."""
        appearances = [appearance for _, appearance in self.rows]
        if not any(appearances):
            return np.zeros(0, dtype=APPEARANCE)
        return np.array([appearance or PLAIN_APPEARANCE for appearance in appearances], dtype=np.float32).view(APPEARANCE)[:, 0]


def opaque_alpha(material: Material) -> float:
    """Returns the smallest alpha at which a material is drawn as opaque."""
    return material.alpha_cutoff if material.alpha_mode == "mask" else OPAQUE_ALPHA


def apply_appearance(material: Material, appearance: Appearance) -> Material:
    """Returns a material with an appearance, except for texture tints and patterns, which shaders apply."""
    changes: dict[str, object] = {}
    if appearance.is_tint and material.texture is None and not material.colored and appearance.pattern is None:
        changes["base_color"] = (*_tinted(material.base_color[:3], appearance), material.base_color[3])
    if appearance.metallic is not None:
        changes["metallic"] = appearance.metallic
    if appearance.roughness is not None:
        changes["roughness"] = appearance.roughness
    return replace(material, **changes)  # type: ignore[arg-type]


def is_drawn(material: Material, appearance: Appearance | None) -> bool:
    """Returns whether shaders must apply the appearance, because it tints a texture or has a pattern."""
    return appearance is not None and (
        appearance.pattern is not None or (appearance.is_tint and (material.texture is not None or material.colored))
    )


def tint_matrix(appearance: Appearance) -> F64:
    """Returns the (3, 3) matrix of a tint in linear light: rotates hue about grey, then scales saturation, then value."""
    angle = 2.0 * np.pi * appearance.hue
    c, s = np.cos(angle), np.sin(angle) / np.sqrt(3.0)
    third = (1.0 - c) / 3.0
    rotation = np.array([[c + third, third - s, third + s], [third + s, c + third, third - s], [third - s, third + s, c + third]])
    grey = np.tile(LUMINANCE, (3, 1))
    matrix: F64 = appearance.value * (grey + appearance.saturation * (np.eye(3) - grey)) @ rotation
    return matrix


def _tinted(srgb: tuple[float, ...], appearance: Appearance) -> tuple[float, ...]:
    return tuple(srgb_from_linear(tint_matrix(appearance) @ linear_from_srgb(srgb)).tolist())


def pattern_pictures(patterns: Sequence[Pattern], warn: Warn) -> tuple[dict[Pattern, int], NDArray[np.uint8]]:
    """Creates the images of patterns; patterns that differ only in colours and size share an image.

    Returns:
        The layer of each pattern, and the layers, (L, 256, 256, 3) uint8, sRGB. A shader interpolates between the pattern's two colours
        by the image, per channel, in linear light. An image that cannot be read has layer -1, after a warning.
    """
    layers: dict[tuple[str, int, str], int] = {}
    pictures: list[NDArray[np.uint8]] = []
    layer_of: dict[Pattern, int] = {}
    for pattern in patterns:
        key = (pattern.kind, pattern.seed if pattern.kind == "noise" else 0, pattern.image)
        if key not in layers:
            picture = _picture(pattern, warn)
            layers[key] = -1 if picture is None else len(pictures)
            if picture is not None:
                pictures.append(picture)
        layer_of[pattern] = layers[key]
    return layer_of, np.stack(pictures) if pictures else np.zeros((0, PATTERN_PX, PATTERN_PX, 3), dtype=np.uint8)


def pattern_colors(pattern: Pattern) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Returns the colours for black and for white pixels of the pattern image, sRGB; a pattern of kind ``image`` keeps its colours."""
    return ((0.0,) * 3, (1.0,) * 3) if pattern.kind == "image" else pattern.colors


def _picture(pattern: Pattern, warn: Warn) -> NDArray[np.uint8] | None:
    size = (PATTERN_PX, PATTERN_PX)
    if pattern.kind == "image":
        try:
            pixels = decode_image(read_file(Path(pattern.image), MAX_IMAGE_BYTES))
        except OSError:
            pixels = None
        if pixels is None:
            warn(f"{pattern.image} is not a readable image; the surface keeps its texture")
            return None
        return np.asarray(cv2.resize(np.ascontiguousarray(pixels[:, :, :3]), size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    cell = np.arange(PATTERN_PX) * _CELLS // PATTERN_PX
    if pattern.kind == "stripes":
        share = np.broadcast_to((cell % 2).astype(np.float64), size)
    elif pattern.kind == "checker":
        share = ((cell[:, None] + cell[None, :]) % 2).astype(np.float64)
    else:
        share = _noise(np.random.Generator(np.random.PCG64(pattern.seed)))
    return np.repeat(srgb8_from_linear(share)[:, :, None], 3, axis=2)


def _noise(rng: np.random.Generator) -> F64:
    """Returns value noise of four octaves that repeats without a seam, (256, 256), 0 to 1."""
    total = np.zeros((PATTERN_PX, PATTERN_PX))
    for cells, weight in ((4, 0.5), (8, 0.27), (16, 0.14), (64, 0.09)):
        knots = rng.random((cells, cells))
        coordinate = np.arange(PATTERN_PX) * cells / PATTERN_PX
        low = coordinate.astype(np.int64)
        t = coordinate - low
        t = t * t * (3.0 - 2.0 * t)
        high = (low + 1) % cells
        rows = knots[low] + t[:, None] * (knots[high] - knots[low])
        total += weight * (rows[:, low] + t[None, :] * (rows[:, high] - rows[:, low]))
    return np.clip((total - 0.5) * 2.2 + 0.5, 0.0, 1.0)
