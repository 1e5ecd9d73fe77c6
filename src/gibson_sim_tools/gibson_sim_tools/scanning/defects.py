"""Error model of a scanner: adds sensor errors to ground-truth depths and poses. Pure; errors depend on seed and frame number only.

``sensors.depth_noise`` models noise, quantisation, range and grazing angles. This module adds flying pixels at edges, depth loss on dark and shiny
surfaces, and pose errors (drift and noise).
"""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.transforms import Mat4, matrix_from_quat
from gibson_sim.sensors.depth_noise import apply_depth_noise
from gibson_sim.types import DepthNoise, Frame, ImageEffects
from gibson_sim_tools.scanning.settings import Defects

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Bools = NDArray[np.bool_]

EDGE_STEP = 0.04
"""Least depth step of an edge between neighbouring pixels, as a fraction of the nearer depth."""
DARK_LUMA = 40.0
"""Luma below which a pixel is dark, 0 to 255."""
_PATCH_SIZE_PX = 6
"""Size of the patches without depth, pixels."""
_ROTATION_WEIGHT = 0.15
"""Weight of rotation against translation in the drift, m/rad."""
_POSES, _DRIFT, _COLORS, _PATCHES = range(4)


def frame_rng(seed: int, purpose: int, number: int) -> np.random.Generator:
    """Returns the random generator of a purpose and a frame, so that one setting does not change the random numbers of another."""
    return np.random.default_rng([seed, purpose, number])


def measured_depth(frame: Frame, defects: Defects, shiny: Bools | None, seed: int, number: int) -> F32:
    """Returns the measured depth, (H, W) float32, metres along the optical axis; NaN = none.

    Args:
        frame: true depth and colours.
        defects: settings.
        shiny: (H, W), mask of shiny surfaces; None = none.
        seed: of the scan.
        number: of the frame.
    """
    assert frame.depth is not None
    noise = DepthNoise(
        defects.depth_constant, defects.depth_linear, defects.depth_quadratic, defects.disparity_step_px, defects.baseline,
        defects.hole_angle_deg, defects.hole_fraction, defects.range_min, seed,
    )  # fmt: skip
    limited = replace(frame, camera=replace(frame.camera, far=defects.range_max))
    noisy = apply_depth_noise(limited, noise).depth
    assert noisy is not None
    depth = np.where(np.isfinite(noisy), noisy, np.nan).astype(np.float32)
    rng = frame_rng(seed, _PATCHES, number)
    _corrupt_edges(frame.depth, depth, defects, rng)
    loss = _loss_probability(frame, defects, shiny)
    if loss is not None:
        depth[_patch_noise(depth.shape, rng) < loss] = np.nan
    depth[~((depth >= defects.range_min) & (depth <= defects.range_max))] = np.nan
    return depth


def depth_edges(depth: F32) -> Bools:
    """Returns the mask of depth edges, (H, W)."""
    near = np.where(np.isfinite(depth), depth, np.float32(1e6))
    kernel = np.ones((3, 3), np.uint8)
    low, high = cv2.erode(near, kernel), cv2.dilate(near, kernel)
    # On a slanted plane the middle depth lies between both extremes; at an edge it equals one of them.
    step = np.minimum(high - near, near - low)
    return np.asarray((high - low > EDGE_STEP * low) & (step < 0.25 * (high - low)))


def _corrupt_edges(true: F32, depth: F32, defects: Defects, rng: np.random.Generator) -> None:
    """Removes patches of depth along edges and adds flying pixels between the two surfaces, in place."""
    if not (defects.edge_px or defects.flying_fraction):
        return
    at_edge = depth_edges(true)
    if defects.edge_px:
        size = 2 * defects.edge_px + 1
        band = cv2.dilate(at_edge.astype(np.uint8), cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))) > 0
        depth[band & (_patch_noise(depth.shape, rng) < 0.6)] = np.nan
    if defects.flying_fraction:
        is_flying = at_edge & (rng.random(depth.shape, dtype=np.float32) < defects.flying_fraction)
        near = np.where(np.isfinite(true), true, np.float32(np.inf))
        low = cv2.erode(near, np.ones((3, 3), np.uint8))
        high = cv2.dilate(np.where(np.isfinite(true), true, np.float32(0.0)), np.ones((3, 3), np.uint8))
        part = rng.random(depth.shape, dtype=np.float32)
        # Masked: away from edges both depths may be infinite, and inf - inf raises a warning of NumPy.
        depth[is_flying] = low[is_flying] + part[is_flying] * (high[is_flying] - low[is_flying])


def _loss_probability(frame: Frame, defects: Defects, shiny: Bools | None) -> F32 | None:
    """Returns the probability that a pixel loses its depth, (H, W); None = 0 everywhere."""
    loss: F32 | None = None
    if defects.dark_fraction and frame.rgb is not None:
        luma = frame.rgb.astype(np.float32) @ np.array([0.299, 0.587, 0.114], dtype=np.float32)
        loss = np.float32(defects.dark_fraction) * np.clip(1.0 - luma / np.float32(DARK_LUMA), 0.0, 1.0)
    if defects.shiny_fraction and shiny is not None:
        on_shiny = np.where(shiny, np.float32(defects.shiny_fraction), np.float32(0.0))
        loss = on_shiny if loss is None else np.maximum(loss, on_shiny)
    return loss


def _patch_noise(shape: tuple[int, ...], rng: np.random.Generator) -> F32:
    """Returns smooth noise with uniform distribution in 0 to 1, (H, W): values below p form patches that cover a fraction p of the image."""
    height, width = shape
    coarse = rng.standard_normal((height // _PATCH_SIZE_PX + 3, width // _PATCH_SIZE_PX + 3), dtype=np.float32)
    smooth = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    smooth = (smooth - smooth.mean()) / max(float(smooth.std()), 1e-6)
    # The logistic function is within 1 % of the normal distribution's.
    return np.asarray(1.0 / (1.0 + np.exp(-1.702 * smooth)), dtype=np.float32)


def image_effects(defects: Defects, seed: int, number: int) -> ImageEffects:
    """Returns the image effects of a frame, with its own exposure and white balance."""
    rng = frame_rng(seed, _COLORS, number)
    exposure, tint = rng.standard_normal(2)
    return ImageEffects(
        exposure_ev=float(defects.exposure_jitter_ev * exposure),
        white_balance_k=float(np.clip(6500.0 * (1.0 + defects.white_balance_jitter * tint), 1667.0, 25000.0)),
        vignette=defects.vignette,
        shutter_s=defects.shutter_s,
        shot_noise=defects.shot_noise,
        read_noise=defects.read_noise,
        seed=seed,
    )


def estimated_poses(T_world_rig: F64, defects: Defects, seed: int) -> F64:
    """Returns the estimated T_world_rig, (N, 4, 4): a random walk (drift) over the distance travelled, plus independent noise of each view.

    The first view has no drift. Only heading and position drift, because a scanner measures gravity.
    """
    estimated = np.array(T_world_rig, dtype=np.float64)
    drift = np.eye(4)
    steps = frame_rng(seed, _DRIFT, 0)
    for number in range(len(estimated)):
        if number:
            root_distance = math.sqrt(_weighted_distance(T_world_rig[number - 1], T_world_rig[number]))
            shift = steps.standard_normal(3) * defects.drift_m * root_distance
            turn = steps.standard_normal() * math.radians(defects.drift_deg) * root_distance
            drift = drift @ _motion_about(T_world_rig[number, :3, 3], shift, np.array([0.0, 0.0, turn]))
        rng = frame_rng(seed, _POSES, number)
        error = np.eye(4)
        error[:3, 3] = rng.standard_normal(3) * defects.pose_noise_m
        error[:3, :3] = _rotation(rng.standard_normal(3) * math.radians(defects.pose_noise_deg))
        estimated[number] = drift @ T_world_rig[number] @ error
    return estimated


def _weighted_distance(before: F64, after: F64) -> float:
    """Returns the distance between two poses (4, 4), metres: translation plus weighted rotation."""
    cosine = (float(np.trace(before[:3, :3].T @ after[:3, :3])) - 1.0) / 2.0
    return float(np.linalg.norm(after[:3, 3] - before[:3, 3])) + _ROTATION_WEIGHT * math.acos(min(max(cosine, -1.0), 1.0))


def _motion_about(center: F64, shift: F64, turn: F64) -> Mat4:
    """Returns a rigid motion, (4, 4): a rotation vector about a point, and a shift."""
    motion = np.eye(4)
    motion[:3, :3] = _rotation(turn)
    motion[:3, 3] = center - motion[:3, :3] @ center + shift
    return motion


def _rotation(vector: F64) -> F64:
    """Returns the rotation matrix (3, 3) of a rotation vector, radians."""
    angle = float(np.linalg.norm(vector))
    if angle < 1e-15:
        return np.eye(3)
    return matrix_from_quat(np.append(vector / angle * math.sin(angle / 2), math.cos(angle / 2)))
