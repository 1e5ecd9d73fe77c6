"""What encoders, wrong dimensions and slip make of the exact turns of wheels: arithmetic on increments. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence

from gibson_sim.robots.noise import NoiseSource
from gibson_sim.robots.sensor_specs import WheelOdometrySpec

_TURN = 2.0 * math.pi


class OdometryNoise:
    """The errors of one robot's odometry; the slip of a step is decided by the seeds, the robot's name and the stamp alone."""

    def __init__(self, spec: WheelOdometrySpec, name: str, seed: int = 0, left: Sequence[bool] = (True, False)) -> None:
        """Starts with all encoders at 0.

        Args:
            spec: What is wrong.
            name: Of the robot, so that two of a kind slip differently.
            seed: Of the simulation.
            left: For each wheel, in the order of ``increments``, whether it is on the robot's left.
        """
        self._spec = spec
        self._noise = NoiseSource(f"{name}/wheel_odometry", seed, spec.seed)
        self._factors = tuple(spec.left_radius_factor if is_left else spec.right_radius_factor for is_left in left)
        self._slips = any((spec.alpha1, spec.alpha2, spec.alpha3, spec.alpha4))
        self.exact = not (self._slips or spec.encoder_ticks or {*self._factors, spec.separation_factor} != {1.0})
        """Whether nothing is wrong, so that there is no need to ask."""
        self.reset()

    def reset(self) -> None:
        """Puts all encoders back to 0."""
        self._angles = [0.0] * len(self._factors)
        self._ticks = [0] * len(self._factors)

    def wheels(self, increments: Sequence[float]) -> tuple[float, ...]:
        """Returns the turns of the wheels, radians, as their encoders count them and wrong radii scale them.

        Args:
            increments: Radians that the joint of each wheel turned since the last call.
        """
        ticks = self._spec.encoder_ticks
        if not ticks:
            return tuple(increment * factor for increment, factor in zip(increments, self._factors, strict=True))
        out = []
        for i, (increment, factor) in enumerate(zip(increments, self._factors, strict=True)):
            self._angles[i] += increment
            count = math.floor(self._angles[i] * ticks / _TURN)
            out.append((count - self._ticks[i]) * _TURN / ticks * factor)
            self._ticks[i] = count
        return tuple(out)

    def motion(self, stamp_ns: int, forward: float, left: float, turn: float) -> tuple[float, float, float]:
        """Returns a motion of the base (forward m, left m, turn rad) with the slip of a step and the error of a wrong separation."""
        turn /= self._spec.separation_factor
        if not self._slips:
            return forward, left, turn
        distance, angle, spec = math.hypot(forward, left), abs(turn), self._spec
        along, about = self._noise.at(stamp_ns).standard_normal(2).tolist()
        slip = along * math.sqrt(spec.alpha3 * distance + spec.alpha4 * angle)
        # Along the motion; forward where the base turns in place.
        x, y = (forward / distance, left / distance) if distance > 0.0 else (1.0, 0.0)
        return forward + slip * x, left + slip * y, turn + about * math.sqrt(spec.alpha1 * angle + spec.alpha2 * distance)
