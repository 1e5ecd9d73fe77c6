"""Follows a path: localises each view, asks a policy for a velocity, and stops whenever images or place cannot be relied on.

The one class that nodes and benchmarks drive a robot by; all times are given.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from gibson_path_following.errors import SettingError, check_ranges
from gibson_path_following.localisation import Localiser
from gibson_path_following.motions import NS_PER_S, CommandLog
from gibson_path_following.preprocessing import texture
from gibson_path_following.types import STOP, Place, Policy, RecordedPath, Velocity, View

State = Literal["following", "lost", "stale", "finished"]
"""following; lost: the images fit nowhere on the path, or the lens is covered; stale: no new images; finished: at the end of the path."""


@dataclass(frozen=True, slots=True)
class FollowerSettings:
    """When a follower stops."""

    stale_after: float = 0.5
    """Age of the newest images at which the robot stops, seconds."""
    latency: float = 0.0
    """Usual time from a command to its motion, seconds, for the motion that the localiser expects."""
    least_texture: float = 2.0
    """Contrast of a view below which the lens counts as covered, grey levels of 255; 0 = never."""
    end_tolerance: float = 0.5
    """The path is finished within this distance of the last node, nodes."""
    end_views: int = 2
    """Views in a row that must fit there, so that one image that looks like the end does not end a drive."""
    start: float | None = 0.0
    """Node where the robot most likely is at the start; None = anywhere."""
    start_deviation: float = 3.0
    """Standard deviation of ``start``, nodes."""
    max_linear: float = 0.5
    """Largest speed, m/s, whatever a policy returns."""
    max_angular: float = 1.0
    """Largest yaw rate, rad/s."""

    def __post_init__(self) -> None:
        check_ranges(
            self,
            ("stale_after", 0.01, 60.0),
            ("latency", 0.0, 10.0),
            ("least_texture", 0.0, 128.0),
            ("end_tolerance", 0.0, 1000.0),
            ("end_views", 1, 1000),
            ("start_deviation", 0.1, 1e6),
            ("max_linear", 0.0, 10.0),
            ("max_angular", 0.0, 10.0),
        )
        if self.start is not None and not (math.isfinite(self.start) and self.start >= 0.0):
            raise SettingError(f"start is {self.start:g}, must be a node, 0 or more, or None = anywhere")


class PathFollower:
    """Drives one robot along one path. Not thread-safe."""

    def __init__(
        self,
        path: RecordedPath,
        policy: Policy,
        settings: FollowerSettings | None = None,
        localiser: Localiser | None = None,
    ) -> None:
        """Begins at the start of the path, standing.

        Args:
            path: the path.
            policy: what turns views into velocities.
            settings: when to stop; None = the defaults.
            localiser: of this path; None = one with its defaults.

        Raises:
            PathFollowingError: the images of the path are not those of its camera.
        """
        self.settings = settings or FollowerSettings()
        self.localiser = localiser or Localiser(path)
        self._policy = policy
        self._last = float(len(path.nodes) - 1)
        self._log = CommandLog()
        self._stamp_ns: int | None = None
        """Of the newest view, ns."""
        self._placed_ns: int | None = None
        """Of the newest view that was localised, ns."""
        self._at_end = 0
        """Views in a row at the end of the path."""
        self.state: State = "stale"
        """What the follower does; all but ``following`` command a stop."""
        self.place: Place | None = None
        """Where the newest view was; None before the first."""
        self.reset()

    def reset(self) -> None:
        """Begins again at the start of the path."""
        self._log.clear()
        self._stamp_ns, self._placed_ns, self.place, self.state = None, None, None, "stale"
        self._at_end = 0
        self.localiser.reset(self.settings.start, self.settings.start_deviation)
        self._policy.reset()

    def observe(self, stamp_ns: int, view: View) -> Velocity:
        """Returns the velocity until the next view. Views that are not newer than the one before change nothing.

        Args:
            stamp_ns: stamp of the images, ns.
            view: what the cameras see.

        Raises:
            ViewError: the images are not those of the path's camera.
        """
        if self._stamp_ns is not None and stamp_ns <= self._stamp_ns:
            return self._log.last
        self._stamp_ns = stamp_ns
        if self.state == "finished":
            return self._send(stamp_ns, STOP)
        if texture(view) < self.settings.least_texture:
            self.state = "lost"
            return self._send(stamp_ns, STOP)
        motion = None
        if self._placed_ns is not None:
            shift_ns = round(self.settings.latency * NS_PER_S)
            motion = self._log.motion(self._placed_ns - shift_ns, stamp_ns - shift_ns)
        self.place = self.localiser.update(view, motion)
        self._placed_ns = stamp_ns
        if self.place.is_lost:
            self.state = "lost"
            return self._send(stamp_ns, STOP)
        at_end = self.place.confidence > 0.0 and self.place.index >= self._last - self.settings.end_tolerance
        self._at_end = self._at_end + 1 if at_end else 0
        if self._at_end >= self.settings.end_views:
            self.state = "finished"
            return self._send(stamp_ns, STOP)
        self.state = "following"
        return self._send(stamp_ns, self._limited(self._policy.act(view, stamp_ns, self.place)))

    def tick(self, now_ns: int) -> Velocity:
        """Returns the velocity to command now: the one of the newest view, or a stop if that is too old.

        Args:
            now_ns: present time on the clock of the stamps, ns.
        """
        age_ns = None if self._stamp_ns is None else now_ns - self._stamp_ns
        if self.state != "finished" and (age_ns is None or age_ns > self.settings.stale_after * NS_PER_S):
            self.state = "stale"
            return self._send(now_ns, STOP)
        return self._log.last

    def hold(self, now_ns: int) -> Velocity:
        """Commands a stop, whatever the views say: another instance, such as a dead man's switch, does not let the robot drive.

        Args:
            now_ns: present time on the clock of the stamps, ns.
        """
        return self._send(now_ns, STOP)

    def _send(self, now_ns: int, velocity: Velocity) -> Velocity:
        self._log.add(now_ns, velocity)
        return velocity

    def _limited(self, velocity: Velocity) -> Velocity:
        if not (math.isfinite(velocity.linear) and math.isfinite(velocity.angular)):
            return STOP
        settings = self.settings
        return Velocity(
            min(max(velocity.linear, -settings.max_linear), settings.max_linear),
            min(max(velocity.angular, -settings.max_angular), settings.max_angular),
        )
