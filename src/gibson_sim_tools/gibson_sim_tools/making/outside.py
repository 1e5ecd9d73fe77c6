"""Draws the panorama outside the windows (sky, trees, meadow), as a camera exposed for the room sees it."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]
WIDTH, HEIGHT = 2048, 1024
"""Size of the panorama, pixels."""


def outside_panorama(seed: int) -> NDArray[np.uint8]:
    """Returns an equirectangular image, (1024, 2048, 3) uint8 sRGB; row 0 is the zenith."""
    rng = np.random.default_rng((seed, 21))
    elevation = (0.5 - (np.arange(HEIGHT) + 0.5) / HEIGHT) * 180.0
    sky_share = np.clip(elevation / 70.0, 0, 1)[:, None, None] ** 0.7
    image = (1 - sky_share) * np.array([0.955, 0.97, 0.985]) + sky_share * np.array([0.70, 0.83, 0.96])
    image = np.repeat(image, WIDTH, axis=1)
    clouds = np.clip((_noise(rng, 5, 1.0) - 0.48) * 3.2, 0, 0.8) * np.clip(elevation / 20.0, 0, 1)[:, None]
    image += clouds[..., None] * (np.array([0.99, 0.99, 0.99]) - image)
    meadow = np.array([0.68, 0.74, 0.56]) * (0.82 + 0.36 * _noise(rng, 9, 0.9))[..., None]
    ground_share = np.clip(-elevation / 1.2, 0, 1)[:, None, None]
    image += ground_share * (meadow - image)
    picture = np.ascontiguousarray(image, dtype=np.float32)
    for haze, top, tone in ((0.6, 15.0, (0.50, 0.60, 0.52)), (0.35, 11.0, (0.36, 0.47, 0.28)), (0.12, 6.0, (0.30, 0.42, 0.20))):
        _trees(picture, rng, top * (0.35 + 0.9 * _outline(rng)), tone, haze)
    image = cv2.GaussianBlur(picture, (0, 0), 1.6)
    # The exposure is for the room, so the outside is overexposed.
    return np.asarray(np.clip(np.round((1 - (1 - np.clip(image, 0, 1)) * 0.62) * 255), 0, 255), dtype=np.uint8)


def _noise(rng: np.random.Generator, octaves: int, falloff: float) -> F64:
    """Returns smooth noise around 0.5, (HEIGHT, WIDTH), seamless across the left and right edges."""
    result, total = np.zeros((HEIGHT, WIDTH), dtype=np.float32), 0.0
    for k in range(octaves):
        rows, columns, weight = 2 ** (k + 1), 2 ** (k + 2), falloff**k
        grid = rng.random((rows, columns), dtype=np.float32)
        wrapped = np.concatenate([grid[:, -2:], grid, grid[:, :2]], axis=1)
        step = WIDTH // columns
        enlarged = cv2.resize(wrapped, (WIDTH + 4 * step, HEIGHT), interpolation=cv2.INTER_CUBIC)
        result += weight * enlarged[:, 2 * step : 2 * step + WIDTH]
        total += weight
    return np.asarray(result / total, dtype=np.float64)


def _trees(
    picture: NDArray[np.float32], rng: np.random.Generator, top: F64, tone: tuple[float, float, float], haze: float
) -> None:
    """Draws a line of trees, their crowns as clusters of leaves lit from above. ``top``: elevation, degrees, (WIDTH,)."""
    per_degree = HEIGHT / 180.0
    for x in np.sort(rng.uniform(0, WIDTH, 150)):
        height = float(top[int(x)]) * rng.uniform(0.7, 1.1) * per_degree
        color = np.array(tone) * rng.uniform(0.75, 1.25)
        ground = HEIGHT / 2 + per_degree * (0.6 + 1.2 * (1 - haze))
        for _ in range(50):
            up, sideways = rng.uniform(0, 1), rng.normal(0, 0.28)
            center = (round(x + sideways * height * (1.1 - up) * 1.4), round(ground - up * height))
            light = (0.55 + 0.75 * up + rng.uniform(-0.2, 0.2)) * color
            color_in_haze = light + haze * (np.array([0.90, 0.93, 0.95]) - light)
            radius = max(2, round(rng.uniform(0.06, 0.15) * height))
            for turn in (-WIDTH, 0, WIDTH):  # wrap around the left and right edges
                cv2.circle(picture, (center[0] + turn, center[1]), radius, color_in_haze.tolist(), -1, cv2.LINE_AA)


def _outline(rng: np.random.Generator) -> F64:
    """Returns the relative height of a line of trees in each column, (WIDTH,), 0 to 1."""
    angle, heights = np.linspace(0, 2 * np.pi, WIDTH, endpoint=False), np.full(WIDTH, 0.5)
    for k in (2, 3, 5, 9, 17, 31, 53, 97, 160):
        heights += 0.32 / k**0.55 * np.sin(k * angle + rng.uniform(0, 6.3))
    return np.asarray(np.clip(heights, 0, 1))
