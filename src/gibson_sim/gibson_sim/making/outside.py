"""What is seen through the windows: sky, trees and meadow as a camera sees them that is exposed for the room. NumPy only."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]
WIDTH, HEIGHT = 2048, 1024


def outside(seed: int) -> NDArray[np.uint8]:
    """Returns an equirectangular picture (1024, 2048, 3), sRGB; row 0 is the zenith."""
    rng = np.random.default_rng((seed, 21))
    elevation = (0.5 - (np.arange(HEIGHT) + 0.5) / HEIGHT) * 180.0
    high = np.clip(elevation / 70.0, 0, 1)[:, None, None] ** 0.7
    image = (1 - high) * np.array([0.955, 0.97, 0.985]) + high * np.array([0.70, 0.83, 0.96])
    image = np.repeat(image, WIDTH, axis=1)
    clouds = np.clip((_noise(rng, 5, 1.0) - 0.48) * 3.2, 0, 0.8) * np.clip(elevation / 20.0, 0, 1)[:, None]
    image += clouds[..., None] * (np.array([0.99, 0.99, 0.99]) - image)
    meadow = np.array([0.74, 0.81, 0.60]) * (0.93 + 0.14 * _noise(rng, 7, 0.8))[..., None]
    below = np.clip(-elevation / 1.2, 0, 1)[:, None, None]
    image += below * (meadow - image)
    for haze, top, tone in ((0.6, 6.5, (0.50, 0.60, 0.52)), (0.35, 5.0, (0.38, 0.50, 0.32)), (0.15, 3.0, (0.33, 0.46, 0.25))):
        ragged = 7.0 * (_noise(rng, 9, 0.75) - 0.5)
        line = top * (0.3 + 1.2 * _outline(rng))
        inside = np.clip((line[None] + ragged - elevation[:, None]) / 0.4, 0, 1) * np.clip(
            (elevation[:, None] + 2.2 + 1.5 * (0.7 - haze)) / 0.5, 0, 1
        )
        leaves = np.array(tone) * (0.25 + 1.5 * _noise(rng, 9, 0.8))[..., None]
        leaves += haze * (np.array([0.90, 0.93, 0.95]) - leaves)
        image += inside[..., None] * (leaves - image)
    # The room is what the camera is exposed for: outside is too bright.
    return np.asarray(np.clip(np.round((1 - (1 - np.clip(image, 0, 1)) * 0.62) * 255), 0, 255), dtype=np.uint8)


def _noise(rng: np.random.Generator, octaves: int, falloff: float) -> F64:
    """Returns noise about 0.5 that goes on across the seam."""
    result, total = np.zeros((HEIGHT, WIDTH)), 0.0
    for k in range(octaves):
        rows, columns, weight = 2 ** (k + 1), 2 ** (k + 2), falloff**k
        grid = rng.random((rows + 1, columns))
        y, x = np.linspace(0, rows, HEIGHT, endpoint=False), np.linspace(0, columns, WIDTH, endpoint=False)
        j, i = y.astype(int), x.astype(int)
        v, u = _eased(y - j)[:, None], _eased(x - i)[None]
        above = grid[j][:, i] * (1 - u) + grid[j][:, (i + 1) % columns] * u
        under = grid[j + 1][:, i] * (1 - u) + grid[j + 1][:, (i + 1) % columns] * u
        result += weight * (above * (1 - v) + under * v)
        total += weight
    return result / total


def _outline(rng: np.random.Generator) -> F64:
    """Returns the height of a line of trees in each direction, 0 to 1."""
    angle, line = np.linspace(0, 2 * np.pi, WIDTH, endpoint=False), np.full(WIDTH, 0.5)
    for k in (2, 3, 5, 9, 17, 31, 53, 97, 160):
        line += 0.32 / k**0.55 * np.sin(k * angle + rng.uniform(0, 6.3))
    return np.asarray(np.clip(line, 0, 1))


def _eased(t: F64) -> F64:
    return np.asarray(t * t * (3 - 2 * t))
