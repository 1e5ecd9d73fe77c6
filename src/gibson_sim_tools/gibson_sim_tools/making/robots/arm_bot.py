"""Models the visual shapes of ``arm_bot``: solids of each link, in its frame. Dimensions follow the URDF."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from gibson_sim.types import Vec3
from gibson_sim_tools.making.robots.surfaces import ClosedSurface, Finish, Section, box, loft, tube, write_solids

FINISHES: Mapping[str, Finish] = {
    "shell": Finish((0.91, 0.92, 0.92), roughness=0.38),
    "graphite": Finish((0.17, 0.18, 0.20), roughness=0.5),
    "rubber": Finish((0.07, 0.07, 0.075), roughness=0.85),
    "steel": Finish((0.68, 0.70, 0.72), roughness=0.35, metallic=0.8),
    "glass": Finish((0.02, 0.025, 0.03), roughness=0.12),
    "accent": Finish((0.95, 0.49, 0.10), roughness=0.45),
    "light": Finish((1.0, 0.62, 0.2), roughness=0.6, emissive=(0.9, 0.38, 0.08)),
}
_ALONG_X: Vec3 = (0.0, math.pi / 2, 0.0)
_ALONG_Y: Vec3 = (-math.pi / 2, 0.0, 0.0)


def arm_bot_solids() -> dict[str, list[ClosedSurface]]:
    """Returns the solids of each visible link, by its name."""
    return {
        "base_link": _base(),
        "wheel": _wheel(),
        "torso_lift_link": _torso(),
        "head_pan_link": _neck(),
        "head_tilt_link": _head(),
        "shoulder_pan_link": _shoulder(),
        "shoulder_lift_link": _pitch_link(0.060, 0.062, 0.220, 0.054),
        "upperarm_roll_link": _roll_link(0.050, 0.130, 0.052, 0.054),
        "elbow_flex_link": _pitch_link(0.053, 0.055, 0.200, 0.046),
        "forearm_roll_link": _roll_link(0.043, 0.125, 0.046, 0.048),
        "wrist_flex_link": _pitch_link(0.047, 0.049, 0.140, 0.040),
        "wrist_roll_link": _flange(),
        "gripper_link": _palm(),
        "finger": _finger(),
    }


def write_arm_bot(folder: Path) -> list[Path]:
    """Writes ``<link>.glb`` for each link; returns the paths."""
    folder.mkdir(parents=True, exist_ok=True)
    files = []
    for link, solids in arm_bot_solids().items():
        files.append(folder / f"{link}.glb")
        write_solids(files[-1], solids, FINISHES)
    return files


def _base() -> list[ClosedSurface]:
    return [
        tube([(0.028, 0.262), (0.098, 0.274)], "graphite", 0.012, 0.004),
        tube([(0.097, 0.268), (0.107, 0.268)], "light"),
        tube([(0.106, 0.274), (0.150, 0.275), (0.205, 0.273), (0.258, 0.264)], "shell", 0.004, 0.022),
        # The core behind the lidar supports the lid; the slot is open at the front.
        box((-0.215, -0.190, 0.235), (0.070, 0.190, 0.325), "graphite", 0.09, 0.004),
        tube([(0.254, 0.052), (0.270, 0.052)], "graphite", 0.003).transformed((0.175, 0.0, 0.0)),
        tube([(0.270, 0.047), (0.308, 0.043)], "glass", 0.003, 0.008).transformed((0.175, 0.0, 0.0)),
        tube([(0.316, 0.264), (0.330, 0.267), (0.362, 0.252)], "shell", 0.008, 0.018),
        # The mast on which the torso slides, and its collar.
        box((-0.205, -0.145, 0.355), (-0.005, 0.145, 0.374), "graphite", 0.07, 0.006),
        box((-0.180, -0.112, 0.360), (-0.030, 0.112, 0.790), "steel", 0.05, 0.004),
        # A handle, a stop button and its collar at the back.
        tube([(0.360, 0.026), (0.372, 0.024)], "graphite", 0.002, 0.004).transformed((-0.175, 0.165, 0.0)),
        tube([(0.372, 0.017), (0.388, 0.018)], "accent", 0.001, 0.006).transformed((-0.175, 0.165, 0.0)),
        *(tube([(-0.012, 0.026), (0.012, 0.026)], "rubber", 0.006).transformed((x, y, 0.030), _ALONG_Y)
          for x in (0.20, -0.20) for y in (0.12, -0.12)),
    ]  # fmt: skip


def _wheel() -> list[ClosedSurface]:
    return [
        tube([(-0.020, 0.0625), (0.020, 0.0625)], "rubber", 0.008).transformed(rpy=_ALONG_Y),
        tube([(-0.023, 0.042), (0.023, 0.042)], "steel", 0.004).transformed(rpy=_ALONG_Y),
    ]


def _torso() -> list[ClosedSurface]:
    spine = [
        Section(0.000, 0.092, 0.128, 0.060, -0.018),
        Section(0.120, 0.094, 0.130, 0.062, -0.018),
        Section(0.260, 0.092, 0.128, 0.062, -0.020),
        Section(0.400, 0.084, 0.116, 0.060, -0.026),
        Section(0.500, 0.072, 0.094, 0.056, -0.028),
        Section(0.555, 0.064, 0.080, 0.052, -0.024),
    ]
    return [
        loft(spine, "shell", 0.010, 0.022),
        # The bracket of the arm, at the front.
        loft(
            [Section(0.165, 0.060, 0.070, 0.055, 0.020), Section(0.235, 0.105, 0.092, 0.085, 0.070), Section(0.318, 0.112, 0.094, 0.090, 0.078)],
            "shell", 0.030, 0.012,
        ),
        tube([(0.312, 0.074), (0.332, 0.074)], "graphite", 0.003).transformed((0.12, 0.0, 0.0)),
        box((0.060, -0.046, 0.060), (0.0765, 0.046, 0.112), "graphite", 0.006, 0.004),
        box((0.070, -0.034, 0.082), (0.0785, 0.034, 0.090), "light", 0.002, 0.001),
        tube([(0.548, 0.056), (0.566, 0.056)], "graphite", 0.003).transformed((0.0, 0.0, 0.0)),
    ]  # fmt: skip


def _neck() -> list[ClosedSurface]:
    """Returns the neck. Its frame is 0.05 m ahead of the torso's and 0.603 m above it; the tilt axis is 0.143 m ahead and 0.058 m higher."""
    return [
        tube([(-0.040, 0.050), (-0.014, 0.050)], "graphite", 0.003).transformed((-0.053, 0.0, 0.0)),
        loft(
            [Section(-0.016, 0.058, 0.056, 0.052, -0.048), Section(0.030, 0.076, 0.052, 0.048, -0.010), Section(0.080, 0.088, 0.044, 0.040, 0.048)],
            "shell", 0.010, 0.020,
        ),
        tube([(-0.050, 0.030), (0.050, 0.030)], "graphite", 0.005).transformed((0.118, 0.0, 0.052), _ALONG_Y),
    ]  # fmt: skip


def _head() -> list[ClosedSurface]:
    """Returns the head. Its camera is 0.055 m ahead of the tilt axis and 0.022 m above it."""
    skull = [
        Section(-0.150, 0.034, 0.040, 0.033, 0.000, -0.020),
        Section(-0.110, 0.044, 0.052, 0.042, 0.000, -0.020),
        Section(0.000, 0.047, 0.056, 0.045, 0.000, -0.022),
        Section(0.110, 0.044, 0.052, 0.042, 0.000, -0.020),
        Section(0.150, 0.034, 0.040, 0.033, 0.000, -0.020),
    ]
    return [
        loft(skull, "shell", 0.026).transformed(rpy=_ALONG_Y),
        box((0.020, -0.100, -0.004), (0.0505, 0.100, 0.048), "glass", 0.006, 0.010),
        *(
            tube([(0.0, radius), (height, radius - 0.0015)], finish).transformed((0.0495, y, 0.022), _ALONG_X)
            for y in (0.042, -0.042)
            for radius, height, finish in ((0.0145, 0.003, "steel"), (0.0115, 0.004, "glass"))
        ),
        *(box((0.0495, y - 0.008, 0.018), (0.0515, y + 0.008, 0.026), "light", 0.002, 0.0005) for y in (0.078, -0.078)),
    ]


def _shoulder() -> list[ClosedSurface]:
    """Returns the shoulder, from the pan axis to the lift axis, 0.117 m ahead and 0.06 m above."""
    return [
        tube([(-0.018, 0.070), (-0.004, 0.070)], "accent", 0.002),
        loft(
            [Section(-0.005, 0.071, 0.070, 0.069, 0.0), Section(0.045, 0.080, 0.066, 0.064, 0.016), Section(0.110, 0.072, 0.056, 0.054, 0.040)],
            "shell", 0.004, 0.030,
        ),
        _barrel(0.046, 0.074, "graphite").transformed((0.117, 0.0, 0.06)),
        *_caps(0.046, 0.074, (0.117, 0.0, 0.06)),
    ]  # fmt: skip


def _pitch_link(barrel: float, half: float, length: float, end: float) -> list[ClosedSurface]:
    """Returns a link that rotates about y: a barrel of this radius and half width, and a tube along x that tapers to radius ``end``."""
    return [
        _barrel(barrel, half, "shell"),
        tube([(0.0, barrel * 0.86), (length * 0.35, barrel * 0.90), (length * 0.7, end + 0.004), (length - 0.024, end)], "shell", 0.0, 0.006)
        .transformed(rpy=_ALONG_X),
        tube([(length - 0.026, end - 0.006), (length - 0.004, end - 0.006)], "graphite").transformed(rpy=_ALONG_X),
        tube([(length - 0.018, end - 0.003), (length - 0.012, end - 0.003)], "accent", 0.001).transformed(rpy=_ALONG_X),
    ]  # fmt: skip


def _roll_link(radius: float, length: float, barrel: float, half: float) -> list[ClosedSurface]:
    """Returns a link that rotates about x: a tube that ends in a joint about y."""
    neck = length - barrel * 0.7
    return [
        tube([(-0.006, radius), (0.020, radius + 0.003), (neck * 0.75, radius + 0.001), (neck, radius - 0.006)], "shell", 0.006, 0.012)
        .transformed(rpy=_ALONG_X),
        tube([(neck - 0.015, radius - 0.011), (length, radius - 0.011)], "graphite").transformed(rpy=_ALONG_X),
        _barrel(barrel - 0.014, half + 0.011, "graphite").transformed((length, 0.0, 0.0)),
        *_caps(barrel - 0.014, half + 0.011, (length, 0.0, 0.0)),
    ]  # fmt: skip


def _barrel(radius: float, half: float, finish: str) -> ClosedSurface:
    return tube([(-half, radius), (half, radius)], finish, 0.010).transformed(rpy=_ALONG_Y)


def _caps(radius: float, half: float, middle: Vec3) -> Sequence[ClosedSurface]:
    """Returns discs on both ends of a barrel, each with a coloured ring."""
    x, y, z = middle
    out = []
    for sign in (1.0, -1.0):
        turn: Vec3 = (-sign * math.pi / 2, 0.0, 0.0)
        out.append(tube([(0.0, radius - 0.009), (0.002, radius - 0.010)], "accent").transformed((x, y + sign * half, z), turn))
        out.append(
            tube([(0.0, radius - 0.013), (0.004, radius - 0.015)], "graphite", 0.0, 0.002).transformed(
                (x, y + sign * half, z), turn
            )
        )
    return out


def _flange() -> list[ClosedSurface]:
    return [
        tube([(-0.004, 0.038), (0.030, 0.038)], "graphite", 0.003).transformed(rpy=_ALONG_X),
        tube([(0.006, 0.0385), (0.011, 0.0385)], "accent", 0.001).transformed(rpy=_ALONG_X),
        tube([(0.028, 0.034), (0.058, 0.034)], "steel", 0.002).transformed(rpy=_ALONG_X),
    ]


def _palm() -> list[ClosedSurface]:
    """Returns the palm. Its frame is between the fingertips, 0.165 m ahead of the wrist."""
    return [
        loft(
            [Section(-0.115, 0.036, 0.046, 0.026), Section(-0.095, 0.038, 0.066, 0.026), Section(-0.052, 0.036, 0.074, 0.022)],
            "shell", 0.012, 0.006,
        ).transformed(rpy=_ALONG_X),
        box((-0.056, -0.072, -0.020), (-0.044, 0.072, 0.020), "graphite", 0.004, 0.002),
        *(tube([(-0.069, 0.004), (0.069, 0.004)], "steel").transformed((-0.043, 0.0, z), _ALONG_Y) for z in (0.011, -0.011)),
    ]  # fmt: skip


def _finger() -> list[ClosedSurface]:
    """Returns the left finger; its inner face is at y = 0."""
    return [
        box((-0.050, 0.001, -0.017), (-0.030, 0.030, 0.017), "graphite", 0.004, 0.003),
        box((-0.036, 0.0035, -0.013), (0.030, 0.0145, 0.013), "steel", 0.004, 0.003),
        box((-0.028, 0.0, -0.0125), (0.029, 0.0045, 0.0125), "rubber", 0.0015, 0.001),
    ]
