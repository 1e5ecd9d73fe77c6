"""What sensors other than cameras a robot carries: pure values."""

from __future__ import annotations

from dataclasses import dataclass

from gibson_sim.errors import ConfigError


@dataclass(frozen=True, slots=True)
class LidarSpec:
    """A planar lidar: one turn of evenly spaced rays, the first along the link's x axis, counter-clockwise."""

    link: str
    """``<body>/<link>``; the rays leave from the origin of this link."""
    beams: int = 360
    range_min: float = 0.12
    """Metres; nearer returns are reported as -inf (REP 117)."""
    range_max: float = 12.0
    """Metres; no return nearer than this is reported as +inf (REP 117)."""
    rate_hz: float = 10.0

    def __post_init__(self) -> None:
        if not 1 <= self.beams <= 100_000:
            raise ConfigError(f"lidar on {self.link!r}: beams is {self.beams}, must be 1 to 100000")
        if not 0.0 <= self.range_min < self.range_max:
            raise ConfigError(
                f"lidar on {self.link!r}: range_min is {self.range_min:g} and range_max {self.range_max:g}, "
                "must be 0 <= range_min < range_max"
            )
        if not 0.0 < self.rate_hz <= 1000.0:
            raise ConfigError(f"lidar on {self.link!r}: rate_hz is {self.rate_hz:g}, must be in (0, 1000]")
