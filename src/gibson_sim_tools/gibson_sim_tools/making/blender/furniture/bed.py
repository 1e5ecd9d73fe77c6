"""Models beds. NumPy only."""

from __future__ import annotations

import numpy as np

from gibson_sim_tools.making.blender.appearances import surface_of, vary_color
from gibson_sim_tools.making.blender.furniture.living import WOODS, choose, legs
from gibson_sim_tools.making.blender.shapes import ObjectBuilder, pose_matrix


def bed(s: ObjectBuilder, d: float, w: float, h: float) -> None:
    """Adds a bed with headboard (at the back), mattress, duvet and pillows."""
    frame = choose(s, (*WOODS, "fabric_grey", "fabric_beige"))
    back, base = -d / 2 + 0.07, 0.30
    if frame.material == "fabric":
        s.cushion((-d / 2, -w / 2, 0.0), (back, w / 2, h), frame, 9, 8)
    else:
        s.box((-d / 2, -w / 2, 0.0), (back, w / 2, h), frame, 0.012, "-x -z")
    s.box((back, -w / 2, 0.10), (d / 2, w / 2, base), frame, 0.01, "-x -z +z")
    legs(s, d, w, 0.1, surface_of("wood_black"), 0.025, 0.1)
    top = 0.52
    s.cushion(
        (back, -w / 2 + 0.03, base - 0.04), (d / 2 - 0.03, w / 2 - 0.03, top), surface_of("linen", (0.92, 0.91, 0.89)), 14, 6
    )
    _duvet(s, (back + 0.62, d / 2 - 0.005), w / 2, top)
    count = 2 if w > 1.3 else 1
    for k in range(count):
        for level in range(2):
            first = len(s.parts)
            tone = vary_color((0.92, 0.91, 0.88), s.rng, 0.02) if level == 0 else vary_color((0.74, 0.76, 0.76), s.rng, 0.06)
            width = 0.33 if level == 0 else 0.27
            part = s.cushion((-0.09, -width, -0.2), (0.09, width, 0.2), surface_of("linen", tone), 2.8, 8, noise=0.012)
            part.vertices[:, 0] *= 1.0 - 0.45 * (np.abs(part.vertices[:, 1]) / width * np.abs(part.vertices[:, 2]) / 0.2)
            y = (k - (count - 1) / 2) * w * 0.47 + s.rng.uniform(-0.03, 0.03)
            s.transform(
                first,
                pose_matrix(
                    (back + 0.17 + 0.17 * level, y, top + 0.17 - 0.03 * level), s.rng.uniform(-0.08, 0.08), -0.75 + 0.1 * level
                ),
            )
    s.collide((-d / 2, -w / 2, 0), (back, w / 2, h))
    s.collide((back, -w / 2, 0), (d / 2, w / 2, top + 0.03))


def _duvet(s: ObjectBuilder, along: tuple[float, float], half: float, top: float) -> None:
    """Adds a duvet that covers the bed and hangs over its sides in soft folds."""
    names = ("fabric_blue", "fabric_beige", "linen", "fabric_striped", "fabric_green", "fabric_grey")
    cloth = choose(s, names)
    nx, ny = 22, 30
    x = np.linspace(*along, nx)
    u = np.linspace(-1, 1, ny) * (half + 0.24)
    drop = np.maximum(np.abs(u) - (half - 0.03), 0.0)
    y = np.sign(u) * np.minimum(np.abs(u), half - 0.03 + 0.028 * np.tanh(drop * 30))
    z = top + 0.035 - np.maximum(drop - 0.01, 0.0)
    grid = np.stack(
        [np.broadcast_to(x[:, None], (nx, ny)), np.broadcast_to(y, (nx, ny)), np.broadcast_to(z, (nx, ny))], axis=-1
    ).copy()
    phase = s.rng.uniform(0, 6.3, 4)
    X, U = np.meshgrid(x, u, indexing="ij")
    wrinkle = (
        0.008 * np.sin(5 * X + 3 * U + phase[0])
        + 0.006 * np.sin(9 * X - 7 * U + phase[1])
        + 0.004 * np.sin(17 * U + 4 * X + phase[2])
    )
    on_top = np.abs(U) < half - 0.03
    grid[..., 2] += np.where(on_top, wrinkle, 0)
    grid[..., 1] += np.where(
        on_top, 0, np.sign(U) * np.clip(0.012 * np.sin(16 * X + phase[3]), -0.005, 1) * np.minimum(1, drop * 8)
    )
    grid[0, :, 2] -= np.where(on_top[0], 0.03, 0)
    grid[..., 2] = np.maximum(grid[..., 2], 0.12)
    grid[..., 1] = np.clip(grid[..., 1], -half - 0.012, half + 0.012)
    s.sheet(grid, cloth)


BUILDERS = {"double_bed": bed, "single_bed": bed}
