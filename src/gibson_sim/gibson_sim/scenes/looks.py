"""What looks do to materials. Pure: meshes, textures and what is solid stay as they are, so that no geometry can change."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.colours import LUMINANCE, linear_from_srgb, srgb8_from_linear, srgb_from_linear
from gibson_sim.reading import read_file
from gibson_sim.robots.spec import Look, Pattern
from gibson_sim.scenes.image_header import MAX_IMAGE_BYTES
from gibson_sim.scenes.mesh_types import F64, Material
from gibson_sim.scenes.textures import Warn, decode_image

PATTERN_PX = 256
"""Side of the picture of a pattern, pixels."""
_CELLS = 8
"""Cells of a checker, and stripes, along one side: even, so that it repeats without a seam."""


def apply_look(material: Material, look: Look) -> Material:
    """Returns a material under a look, but for what concerns textures: tints of these and patterns are drawn by the renderer."""
    changes: dict[str, object] = {}
    if look.is_tint and material.texture is None and not material.colored and look.pattern is None:
        changes["base_color"] = (*_tinted(material.base_color[:3], look), material.base_color[3])
    if look.metallic is not None:
        changes["metallic"] = look.metallic
    if look.roughness is not None:
        changes["roughness"] = look.roughness
    return replace(material, **changes)  # type: ignore[arg-type]


def is_drawn(material: Material, look: Look | None) -> bool:
    """Whether a look changes more than ``apply_look`` says: the renderer has to tint a texture, or to draw a pattern."""
    return look is not None and (
        look.pattern is not None or (look.is_tint and (material.texture is not None or material.colored))
    )


def tint_matrix(look: Look) -> F64:
    """Returns what takes colours to tinted ones, (3, 3), linear light: hue turns about grey, saturation away from it, then value."""
    angle = 2.0 * np.pi * look.hue
    c, s = np.cos(angle), np.sin(angle) / np.sqrt(3.0)
    third = (1.0 - c) / 3.0
    turn = np.array([[c + third, third - s, third + s], [third + s, c + third, third - s], [third - s, third + s, c + third]])
    grey = np.tile(LUMINANCE, (3, 1))
    matrix: F64 = look.value * (grey + look.saturation * (np.eye(3) - grey)) @ turn
    return matrix


def _tinted(srgb: tuple[float, ...], look: Look) -> tuple[float, ...]:
    return tuple(srgb_from_linear(tint_matrix(look) @ linear_from_srgb(srgb)).tolist())


def pattern_pictures(patterns: Sequence[Pattern], warn: Warn) -> tuple[dict[Pattern, int], NDArray[np.uint8]]:
    """Makes the pictures that patterns consist of: patterns that differ in colours and size alone share one.

    Returns:
        The layer of each pattern, and the layers, (L, 256, 256, 3) uint8, sRGB. A pattern mixes its two colours by the picture's,
        channel by channel, in linear light. An image that cannot be read has layer -1, after a warning.
    """
    layers: dict[tuple[str, int, str], int] = {}
    pictures: list[NDArray[np.uint8]] = []
    found: dict[Pattern, int] = {}
    for pattern in patterns:
        key = (pattern.kind, pattern.seed if pattern.kind == "noise" else 0, pattern.image)
        if key not in layers:
            picture = _picture(pattern, warn)
            layers[key] = -1 if picture is None else len(pictures)
            if picture is not None:
                pictures.append(picture)
        found[pattern] = layers[key]
    return found, np.stack(pictures) if pictures else np.zeros((0, PATTERN_PX, PATTERN_PX, 3), dtype=np.uint8)


def pattern_colors(pattern: Pattern) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Returns the colours where the picture is black and where it is white, sRGB: for an image these are its own."""
    return ((0.0,) * 3, (1.0,) * 3) if pattern.kind == "image" else pattern.colors


def _picture(pattern: Pattern, warn: Warn) -> NDArray[np.uint8] | None:
    size = (PATTERN_PX, PATTERN_PX)
    if pattern.kind == "image":
        try:
            pixels = decode_image(read_file(Path(pattern.image), MAX_IMAGE_BYTES))
        except OSError:
            pixels = None
        if pixels is None:
            warn(f"{pattern.image}: is no image that can be read; the surface keeps its own texture")
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
    """Returns clouds of several sizes that repeat without a seam, (256, 256), 0 to 1."""
    total = np.zeros((PATTERN_PX, PATTERN_PX))
    for cells, weight in ((4, 0.5), (8, 0.27), (16, 0.14), (64, 0.09)):
        knots = rng.random((cells, cells))
        at = np.arange(PATTERN_PX) * cells / PATTERN_PX
        low = at.astype(np.int64)
        t = at - low
        t = t * t * (3.0 - 2.0 * t)
        high = (low + 1) % cells
        rows = knots[low] + t[:, None] * (knots[high] - knots[low])
        total += weight * (rows[:, low] + t[None, :] * (rows[:, high] - rows[:, low]))
    return np.clip((total - 0.5) * 2.2 + 0.5, 0.0, 1.0)
