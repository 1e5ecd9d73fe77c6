"""Image-based lighting: the irradiance of an environment map, its prefiltered reflections, and the BRDF table.

Pure NumPy, no OpenGL. Directions are in the world frame: the middle column of an equirectangular image is at +x, the top row at +z, and
the left quarter at +y.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import SceneError
from gibson_sim.formats.image_header import MAX_IMAGE_BYTES, image_size
from gibson_sim.formats.textures import decode_pixels
from gibson_sim.geometry.colours import linear_from_srgb
from gibson_sim.reading import read_file

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
REFLECTION_SIZE = 256
"""Side of an octahedral image, texels, including a border of one texel, so that filtering never reads beyond an edge."""
REFLECTION_LAYERS = 8
"""Number of roughness layers: layer k has roughness k / 7."""
REFLECTANCE_SIZE = 32
"""Side of the table of ``reflectance``, texels."""
_MAX_WIDTH = 2048
_MAX_PIXELS = 8192 * 4096
"""Maximum number of pixels of an environment image: 400 MB as floats."""
_SAMPLES = 128
_BRIGHTEST = 6e4
"""Largest radiance; the largest half float is 65504."""


def load_environment(path: Path) -> F32:
    """Returns an equirectangular image, (H, W, 3) float32, linear RGB, H = W / 2, at most 2048 wide.

    Raises:
        SceneError: the file cannot be read, or is not an equirectangular image.
    """
    try:
        data = read_file(path, MAX_IMAGE_BYTES)
    except OSError as e:
        raise SceneError(f"environment {path}: cannot be read: {e.strerror or e}") from e
    size = image_size(data)
    if size is not None and size.pixels > _MAX_PIXELS:
        raise SceneError(
            f"environment {path}: has {size.width} x {size.height} pixels, must have at most {_MAX_PIXELS >> 20} million; scale it down, "
            f"{_MAX_WIDTH} x {_MAX_WIDTH // 2} pixels are used"
        )
    image = decode_pixels(data, cv2.IMREAD_UNCHANGED)
    if image is None:
        raise SceneError(f"environment {path}: is not a readable image; give a .hdr, .png or .jpg file")
    if image.ndim == 2:
        image = np.repeat(image[:, :, None], 3, axis=2)
    height, width = image.shape[:2]
    if width != 2 * height or height < 4:
        raise SceneError(f"environment {path}: is {width}x{height} pixels; an equirectangular image is twice as wide as high")
    rgb = image[:, :, 2::-1]
    if image.dtype == np.float32:
        linear = rgb.astype(np.float32)
    else:
        linear = linear_from_srgb(rgb.astype(np.float32) / np.float32(65535.0 if image.dtype == np.uint16 else 255.0))
    linear = np.clip(np.nan_to_num(linear), 0.0, _BRIGHTEST)
    if width > _MAX_WIDTH:
        linear = np.asarray(cv2.resize(linear, (_MAX_WIDTH, _MAX_WIDTH // 2), interpolation=cv2.INTER_AREA))
    return np.ascontiguousarray(linear, dtype=np.float32)


def directions(height: int) -> F64:
    """Returns the unit vectors of the pixels of an equirectangular image, (H, 2 H, 3)."""
    polar = (np.arange(height) + 0.5) / height * np.pi
    azimuth = np.pi - (np.arange(2 * height) + 0.5) / height * np.pi
    sin = np.sin(polar)[:, None]
    z = np.broadcast_to(np.cos(polar)[:, None], (height, 2 * height))
    return np.stack([sin * np.cos(azimuth), sin * np.sin(azimuth), z], axis=2)


def look_up(image: F32, rays: F64) -> F32:
    """Returns the image's colours, (..., 3), bilinearly interpolated, in directions (..., 3) of any length."""
    height, width = image.shape[:2]
    flat = rays.reshape(-1, 3)
    length = np.maximum(np.linalg.norm(flat, axis=1), 1e-12)
    u = (0.5 - np.arctan2(flat[:, 1], flat[:, 0]) / (2.0 * np.pi)) * width - 0.5
    v = np.clip(np.arccos(np.clip(flat[:, 2] / length, -1.0, 1.0)) / np.pi * height - 0.5, 0.0, height - 1.0)
    # OpenCV limits maps to 32767 rows and columns.
    rows = -(-len(u) // 4096)
    coordinates = np.zeros((2, rows * 4096), dtype=np.float32)
    coordinates[0, : len(u)], coordinates[1, : len(u)] = u, v
    x, y = coordinates.reshape(2, rows, 4096)
    colours = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
    return np.asarray(colours.reshape(-1, 3)[: len(u)].reshape(rays.shape), dtype=np.float32)


def irradiance(image: F32) -> F32:
    """Returns the radiance of a white Lambertian surface lit by the image as a polynomial of its normal, (9, 3) float32.

    Spherical harmonics up to degree 2, attenuated by the cosine lobe by 1, 2/3 and 1/4. The coefficients belong to the terms
    1, y, z, x, xy, yz, z^2, xz and x^2 - y^2; the -1 of 3 z^2 - 1 is included in the first.
    """
    small = np.asarray(cv2.resize(image, (128, 64), interpolation=cv2.INTER_AREA), dtype=np.float64)
    n = directions(64)
    x, y, z = n[..., 0], n[..., 1], n[..., 2]
    area = np.sin((np.arange(64) + 0.5) / 64 * np.pi)[:, None] * np.ones((1, 128))
    area *= 4.0 * np.pi / area.sum()
    one = np.ones_like(x)
    terms = np.stack([one, y, z, x, x * y, y * z, 3.0 * z * z - 1.0, x * z, x * x - y * y])
    # Squares of the normalisation of each term.
    norms = np.array([1 / 4, 3 / 4, 3 / 4, 3 / 4, 15 / 4, 15 / 4, 5 / 16, 15 / 4, 15 / 16]) / np.pi
    attenuation = np.array([1.0, 2 / 3, 2 / 3, 2 / 3, 1 / 4, 1 / 4, 1 / 4, 1 / 4, 1 / 4])
    factors: F64 = np.einsum("thw,hwc,hw->tc", terms, small, area) * (norms * attenuation)[:, None]
    factors[0] -= factors[6]
    factors[6] *= 3.0
    return np.asarray(factors, dtype=np.float32)


def octahedral_rays(size: int) -> F64:
    """Returns the unit vectors of the texels of an octahedral image with a border of one texel, (size, size, 3); rows are y."""
    e = (np.arange(size) - 0.5) / (size - 2) * 2.0 - 1.0
    x, y = np.meshgrid(e, e)
    # Border texels lie beyond the edge: each edge is folded onto itself about its middle.
    over = np.abs(x) > 1.0
    x, y = np.where(over, np.sign(x) * 2.0 - x, x), np.where(over, -y, y)
    over = np.abs(y) > 1.0
    x, y = np.where(over, -x, x), np.where(over, np.sign(y) * 2.0 - y, y)
    z = 1.0 - np.abs(x) - np.abs(y)
    fx, fy = (1.0 - np.abs(y)) * np.where(x >= 0, 1.0, -1.0), (1.0 - np.abs(x)) * np.where(y >= 0, 1.0, -1.0)
    rays = np.stack([np.where(z >= 0, x, fx), np.where(z >= 0, y, fy), z], axis=2)
    unit: F64 = rays / np.linalg.norm(rays, axis=2, keepdims=True)
    return unit


def reflections(image: F32) -> NDArray[np.float16]:
    """Returns the prefiltered image for increasing roughness, by reflected direction, (8, 256, 256, 3) float16, octahedral.

    Each layer is the image filtered by the GGX lobe at normal incidence (the first half of the split sum; the second is ``reflectance``).
    """
    pyramid = [image]
    while pyramid[-1].shape[0] > 8:
        height, width = pyramid[-1].shape[:2]
        pyramid.append(np.asarray(cv2.resize(pyramid[-1], (width // 2, height // 2), interpolation=cv2.INTER_AREA)))
    layers = [look_up(_level_for(pyramid, 4.0 * np.pi / REFLECTION_SIZE**2), octahedral_rays(REFLECTION_SIZE))]
    for k in range(1, REFLECTION_LAYERS):
        size = REFLECTION_SIZE // 2 if k < 3 else REFLECTION_SIZE // 4
        layers.append(_enlarge(_filter(pyramid, size, k / (REFLECTION_LAYERS - 1))))
    return np.minimum(np.stack(layers), _BRIGHTEST).astype(np.float16)


def _level_for(pyramid: list[F32], solid_angle: float) -> F32:
    """Returns the pyramid level whose pixels at the horizon cover about the given solid angle, sr."""
    level = 0.5 * np.log2(max(solid_angle / (2.0 * np.pi**2 / pyramid[0].shape[0] ** 2 / 2.0), 1.0))
    return pyramid[min(round(float(level)), len(pyramid) - 1)]


def _filter(pyramid: list[F32], size: int, roughness: float) -> F32:
    """Returns the image filtered by the GGX lobe of a roughness, by importance sampling, (size, size, 3)."""
    n = octahedral_rays(size)
    up = np.where(np.abs(n[..., 2:]) < 0.9, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0])
    t = np.cross(up, n)
    t /= np.linalg.norm(t, axis=2, keepdims=True)
    b = np.cross(n, t)
    a2 = roughness**4
    total: F32 = np.zeros((size, size, 3), dtype=np.float32)
    weights = 0.0
    for u1, u2 in _hammersley(_SAMPLES):
        cos2 = (1.0 - u2) / (1.0 + (a2 - 1.0) * u2)
        cos, sin = np.sqrt(cos2), np.sqrt(1.0 - cos2)
        z = 2.0 * cos2 - 1.0
        if z <= 0.0:
            continue
        # Density of reflected directions: density of half vectors divided by 4 v.h, with n = v.
        density = a2 / (np.pi * (cos2 * (a2 - 1.0) + 1.0) ** 2) / 4.0
        r, angle = 2.0 * cos * sin, 2.0 * np.pi * u1
        ray = (r * np.cos(angle)) * t + (r * np.sin(angle)) * b + z * n
        # Coarser pyramid levels for samples of low density avoid speckles with few samples (Krivanek, Colbert 2008).
        total += look_up(_level_for(pyramid, 2.0 / (_SAMPLES * density)), ray) * np.float32(z)
        weights += z
    return np.asarray(total / np.float32(weights), dtype=np.float32)


def _enlarge(small: F32) -> F32:
    """Returns an octahedral image resampled to full size."""
    size = small.shape[0]
    e = (np.arange(REFLECTION_SIZE, dtype=np.float32) - 0.5) / (REFLECTION_SIZE - 2) * (size - 2) + 0.5
    x, y = np.meshgrid(e, e)
    return np.asarray(cv2.remap(small, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), dtype=np.float32)


def _hammersley(count: int) -> list[tuple[float, float]]:
    """Returns a Hammersley point set in the unit square."""
    bits = max(count - 1, 1).bit_length()
    return [((k + 0.5) / count, (int(f"{k:0{bits}b}"[::-1], 2) + 0.5) / 2**bits) for k in range(count)]


def reflectance() -> NDArray[np.float16]:
    """Returns the directional albedo ``f0 a + b`` of a surface with normal reflectance f0, as a table of (a, b), (32, 32, 2) float16.

    Rows: roughness 0 to 1, columns: cosine between normal and eye 0 to 1, both ends included. GGX, joint Smith, Schlick, as in
    lighting.glsl, which adds multiple scattering.
    """
    cosines = np.linspace(0.0, 1.0, REFLECTANCE_SIZE).clip(1e-3)
    table = np.zeros((REFLECTANCE_SIZE, REFLECTANCE_SIZE, 2))
    u1, u2 = np.array(_hammersley(512)).T
    for row, roughness in enumerate(np.linspace(0.0, 1.0, REFLECTANCE_SIZE)):
        a2 = max(roughness, 0.04) ** 4
        cos = np.sqrt((1.0 - u2) / (1.0 + (a2 - 1.0) * u2))
        h = np.stack([np.sqrt(1.0 - cos**2) * np.cos(2.0 * np.pi * u1), cos], axis=1)  # the eye lies in the plane y = 0
        v = np.stack([np.sqrt(1.0 - cosines**2), cosines], axis=1)
        v_h = v @ h.T
        n_l = 2.0 * v_h * h[:, 1] - cosines[:, None]
        valid = (n_l > 0.0) & (v_h > 0.0)
        n_l = np.where(valid, n_l, 1.0)
        n_v = cosines[:, None]
        visibility = 0.5 / (n_l * np.sqrt(n_v**2 * (1.0 - a2) + a2) + n_v * np.sqrt(n_l**2 * (1.0 - a2) + a2))
        weight = np.where(valid, 4.0 * n_l * visibility * v_h / cos, 0.0)
        fresnel = (1.0 - np.clip(v_h, 0.0, 1.0)) ** 5
        table[row] = np.stack([((1.0 - fresnel) * weight).mean(axis=1), (fresnel * weight).mean(axis=1)], axis=1)
    return table.astype(np.float16)
