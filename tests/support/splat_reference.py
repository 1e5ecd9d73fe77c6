"""Draws Gaussian splats in double precision, splat by splat and pixel by pixel, as Kerbl et al. 2023 and its code do.

Blended front to back in the order of depth, with a low-pass of 0.3 square pixels; splats count where they cover at least 1/255. The code
of the paper also leaves out what lies beyond three standard deviations and ends a pixel that is 99.99 % covered; this one does neither.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gibson_sim.formats.splats import Splats

F64 = NDArray[np.float64]

NEAREST = 0.2
LOW_PASS = 0.3
SPREAD = 1.3


def harmonics(directions: F64) -> F64:
    """Returns the 16 real spherical harmonics, (N, 16), of unit vectors (N, 3), with the signs of the paper's code."""
    x, y, z = directions.T
    xx, yy, zz = x * x, y * y, z * z
    return np.stack(
        [
            np.full_like(x, 0.28209479177387814),
            -0.4886025119029199 * y, 0.4886025119029199 * z, -0.4886025119029199 * x,
            1.0925484305920792 * x * y, -1.0925484305920792 * y * z, 0.31539156525252005 * (2.0 * zz - xx - yy),
            -1.0925484305920792 * x * z, 0.5462742152960396 * (xx - yy),
            -0.5900435899266435 * y * (3.0 * xx - yy), 2.890611442640554 * x * y * z, -0.4570457994644658 * y * (4.0 * zz - xx - yy),
            0.3731763325901154 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy), -0.4570457994644658 * x * (4.0 * zz - xx - yy),
            1.445305721320277 * z * (xx - yy), -0.5900435899266435 * x * (xx - 3.0 * yy),
        ],
        axis=1,
    )  # fmt: skip


def rotations(quats_xyzw: F64) -> F64:
    """Returns rotation matrices (N, 3, 3) of unit quaternions (N, 4)."""
    x, y, z, w = quats_xyzw.T
    return np.stack(
        [
            1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
            2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
            2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
        ],
        axis=1,
    ).reshape(-1, 3, 3)  # fmt: skip


def draw_reference(splats: Splats, T_world_camera: F64, K: F64, width: int, height: int) -> tuple[F64, F64]:
    """Returns the sRGB colours of the splats over black, (H, W, 3), not clipped, and how much of what is behind them is seen, (H, W).

    Args:
        splats: their frame is the world frame.
        T_world_camera: (4, 4), optical frame.
        K: (3, 3), pixels, pixel centres at whole numbers.
        width: pixels.
        height: pixels.
    """
    R = T_world_camera[:3, :3].T
    positions = splats.positions.astype(np.float64)
    eye = T_world_camera[:3, 3]
    p = (positions - eye) @ R.T
    axes = rotations(splats.quats_xyzw.astype(np.float64)) * splats.scales[:, None].astype(np.float64)
    covariance = R @ axes @ axes.transpose(0, 2, 1) @ R.T
    directions = positions - eye
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    basis = harmonics(directions)[:, : splats.sh.shape[1]]
    colors = np.maximum(np.einsum("nk,nkc->nc", basis, splats.sh.astype(np.float64)) + 0.5, 0.0)
    image, left = np.zeros((height, width, 3)), np.ones((height, width))
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    # Far outside the image the projection is linearised at its edge, or splats beside the camera would become huge.
    low = np.array([(-0.5 - cx) / fx, (-0.5 - cy) / fy])
    high = np.array([(width - 0.5 - cx) / fx, (height - 0.5 - cy) / fy])
    margin = (SPREAD - 1.0) * (high - low) / 2.0
    v, u = np.mgrid[:height, :width].astype(np.float64)
    for k in np.argsort(p[:, 2], kind="stable"):
        x, y, z = p[k]
        if z <= NEAREST:
            continue
        tx, ty = np.clip((x / z, y / z), low - margin, high + margin)
        J = np.array([[fx / z, 0.0, -fx * tx / z], [0.0, fy / z, -fy * ty / z]])
        inverse = np.linalg.inv(J @ covariance[k] @ J.T + LOW_PASS * np.eye(2))
        du, dv = u - (fx * x / z + cx), v - (fy * y / z + cy)
        power = -0.5 * (inverse[0, 0] * du * du + inverse[1, 1] * dv * dv) - inverse[0, 1] * du * dv
        alpha = np.minimum(0.99, float(splats.opacities[k]) * np.exp(power))
        alpha[alpha < 1.0 / 255.0] = 0.0
        image += (left * alpha)[:, :, None] * colors[k]
        left *= 1.0 - alpha
    return image, left
