"""Reads the sections of a ``robot.yaml`` that describe sensors other than cameras."""

from __future__ import annotations

from gibson_sim.robots.sensor_specs import LidarSpec
from gibson_sim.robots.settings import Settings
from gibson_sim.robots.urdf import UrdfModel

_LIDAR_KEYS = ("link", "beams", "range_min", "range_max", "rate_hz")


def read_lidar(robot: Settings, model: UrdfModel, name: str) -> LidarSpec | None:
    """Returns the planar lidar; None = the file gives none."""
    settings = robot.section("lidar")
    if settings is None:
        return None
    settings.check_keys(_LIDAR_KEYS)
    link = model.link(settings.text("link")).name
    numbers = settings.numbers(("range_min", "range_max", "rate_hz"))
    return LidarSpec(link=f"{name}/{link}", **settings.integers(("beams",)), **numbers)  # type: ignore[arg-type]
