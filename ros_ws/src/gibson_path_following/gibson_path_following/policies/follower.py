"""Follows a path: localises each view, gets a velocity from a policy, and stops where images or place are unreliable.

Nodes and benchmarks drive a robot by ``PathFollower``; all times are given.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gibson_path_following.errors import SettingError, check_ranges
from gibson_path_following.images.preprocessing import texture
from gibson_path_following.localisation.localiser import Localiser
from gibson_path_following.localisation.motion_model import MotionModel
from gibson_path_following.localisation.motions import NS_PER_S, CommandLog, Motion
from gibson_path_following.types import STOP, Place, Policy, RecordedPath, SelfLocalisingPolicy, Step, Velocity, View

State = Literal["waiting", "localising", "following", "lost", "searching", "stale", "finished"]
"""waiting: no image has come since the start; localising: the first images are compared with the path; following; lost: the images fit nowhere on
the path, or the lens is covered; searching: lost, and rotating in place; stale: no new images, or their stamps are far from the present; finished:
at the end of the path."""
_SEARCH_TURN = math.radians(60.0)
"""Rotation of a search to either side, radians."""
_SEARCH_RATE = 0.4
"""Yaw rate of a search, rad/s."""
_SEARCH_NS = 20 * NS_PER_S
"""Timeout of a search, ns."""
_MAX_GAP_NS = NS_PER_S
"""Time between two views beyond which their column shift is not measured, ns."""
_MIN_SCORE = 0.35
"""Score of two successive views below which their column shift is ignored."""


@dataclass(frozen=True, slots=True)
class FollowerSettings:
    """When a follower stops, and where it starts."""

    stale_after: float = 0.5
    """Age of the newest images, and time since they arrived, at which the robot stops, seconds."""
    latency: float = 0.0
    """Prior mean of the latency from a command to its motion, seconds; the true one is learned from column shifts after commands."""
    min_texture: float = 2.0
    """Texture of a view below which the lens counts as covered, grey levels of 255; 0 = never."""
    end_tolerance: float = 0.5
    """Distance from the last node within which the path is finished, nodes."""
    end_views: int = 2
    """Successive views that must be there, so that one image that looks like the end does not end a drive."""
    start: float | None = 0.0
    """Most likely node index of the robot at the start; None = anywhere."""
    start_deviation: float = 1.0
    """Standard deviation of ``start``, nodes."""
    search: bool = True
    """Whether a lost robot rotates in place to either side, once and slowly, to find the path again. It never drives on."""
    search_after: float = 1.5
    """Time that a lost robot stands before it searches, and that the first place may take before the robot counts as lost, seconds."""
    max_linear: float = 0.5
    """Largest speed, m/s; velocities of the policy are clamped to it."""
    max_angular: float = 1.0
    """Largest yaw rate, rad/s."""

    def __post_init__(self) -> None:
        check_ranges(
            self,
            ("stale_after", 0.01, 60.0),
            ("latency", 0.0, 10.0),
            ("min_texture", 0.0, 128.0),
            ("end_tolerance", 0.0, 1000.0),
            ("end_views", 1, 1000),
            ("start_deviation", 0.1, 1e6),
            ("search_after", 0.0, 3600.0),
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
        """Begins at the start of the path; the robot stands.

        Args:
            path: the path.
            policy: computes the velocities.
            settings: None = the defaults.
            localiser: of this path; None = one with default settings.

        Raises:
            PathFollowingError: the images of the path are not those of its camera.
        """
        self.settings = settings or FollowerSettings()
        self.localiser = localiser or Localiser(path)
        self._policy = policy
        self._last = float(len(path.nodes) - 1)
        self._log = CommandLog()
        self._stamp_ns: int | None = None
        """Stamp of the newest view, ns."""
        self._arrived_ns = 0
        """When it arrived, ns."""
        self._localised_ns: int | None = None
        """Stamp of the newest localised view, ns."""
        self._model = MotionModel(self.settings.latency)
        self._descriptor: NDArray[np.float32] | None = None
        """Descriptor of the previous view."""
        self._at_end = 0
        """Successive views at the end of the path."""
        self._first_ns: int | None = None
        """Stamp of the first view that was localised, ns."""
        self._was_found = False
        """Whether the place was known at any time since the start."""
        self._search = _Search(self.settings.search_after)
        self.state: State = "waiting"
        """State; all but ``following`` and ``searching`` command a stop."""
        self.place: Place | None = None
        """Place of the newest view; None before the first."""
        self.reset()

    def reset(self) -> None:
        """Begins again at the start of the path."""
        self._log.clear()
        self._stamp_ns, self._localised_ns, self.place, self.state = None, None, None, "waiting"
        self._at_end, self._descriptor = 0, None
        self._first_ns, self._was_found = None, False
        self._model.reset()
        self._search.reset()
        self.localiser.reset(self.settings.start, self.settings.start_deviation)
        self._policy.reset()

    def observe(self, stamp_ns: int, view: View, now_ns: int | None = None) -> Velocity:
        """Returns the velocity until the next view. A view that is not newer than the previous one changes nothing.

        Args:
            stamp_ns: stamp of the images, ns.
            view: the images.
            now_ns: when they arrived, on the clock of ``tick``, ns; None = at their stamp.

        Raises:
            ViewError: the images are not those of the path's camera.
        """
        if self._stamp_ns is not None and stamp_ns <= self._stamp_ns:
            return self._log.last
        self._stamp_ns, self._arrived_ns = stamp_ns, stamp_ns if now_ns is None else now_ns
        if self.state == "finished":
            return self._send(stamp_ns, STOP)
        if texture(view) < self.settings.min_texture:
            self.state, self._descriptor = "lost", None
            return self._send(stamp_ns, STOP)
        self.place = self._localise(stamp_ns, view)
        if self.place.is_lost and not (isinstance(self._policy, SelfLocalisingPolicy) and self._policy.is_localised):
            self.state = "lost" if self._was_found or self._is_late(stamp_ns) else "localising"
            turn = self._search.velocity(stamp_ns, self.place.moved.turn) if self.settings.search else STOP
            if turn != STOP:
                self.state = "searching"
            return self._send(stamp_ns, self._clamped(turn))
        self._search.reset()
        self._was_found = True
        at_end = self.place.confidence > 0.0 and self.place.index >= self._last - self.settings.end_tolerance
        self._at_end = self._at_end + 1 if at_end else 0
        if self._at_end >= self.settings.end_views:
            self.state = "finished"
            return self._send(stamp_ns, STOP)
        self.state = "following"
        return self._send(stamp_ns, self._clamped(self._policy.act(view, stamp_ns, self.place)))

    def _localise(self, stamp_ns: int, view: View) -> Place:
        """Returns the place of a view, with the motion since the previous one and the pending motion."""
        previous_ns, self._localised_ns = self._localised_ns, stamp_ns
        previous, self._descriptor = self._descriptor, self.localiser.nodes.descriptor(view)
        if previous_ns is None:
            return self.localiser.update(view, Motion(0.0, 0.0, 0.0))  # the robot stood
        moved = self._model.predict(self._log, previous_ns, stamp_ns, 1.0)
        if previous is not None and stamp_ns - previous_ns <= _MAX_GAP_NS:
            turn, score = self.localiser.nodes.turn_between(previous, self._descriptor)
            if score >= _MIN_SCORE:
                self._model.learn(self._log, previous_ns, stamp_ns, turn)
                moved = replace(self._model.predict(self._log, previous_ns, stamp_ns, 1.0), turn=turn)
        ratio = self.localiser.motion_ratio
        place = self.localiser.update(view, Motion(moved.distance, moved.turn / ratio, (stamp_ns - previous_ns) / NS_PER_S))
        return replace(
            place,
            moved=Step(ratio * moved.distance, moved.turn),
            pending=self._model.pending(self._log, stamp_ns, ratio),
        )

    def tick(self, now_ns: int) -> Velocity:
        """Returns the velocity to command now: that of the newest view, or a stop if that view is stale.

        Args:
            now_ns: present time on the clock of the stamps, ns.
        """
        if self.state != "finished" and self._is_stale(now_ns):
            self.state = "waiting" if self._stamp_ns is None else "stale"
            return self._send(now_ns, STOP)
        return self._log.last

    def _is_late(self, stamp_ns: int) -> bool:
        """Returns whether the place should be known by the time of a view, ns: some time after the first one."""
        if self._first_ns is None:
            self._first_ns = stamp_ns
        return stamp_ns - self._first_ns >= self.settings.search_after * NS_PER_S

    def _is_stale(self, now_ns: int) -> bool:
        """Returns whether there is no view, the newest one arrived too long ago, or its stamp is too old or too far in the future."""
        if self._stamp_ns is None:
            return True
        # The stamp alone is not enough: a camera whose clock is ahead may have died long ago.
        return max(abs(now_ns - self._stamp_ns), now_ns - self._arrived_ns) > self.settings.stale_after * NS_PER_S

    def hold(self, now_ns: int) -> Velocity:
        """Commands a stop: a dead man's switch, for example, does not let the robot drive.

        Args:
            now_ns: present time on the clock of the stamps, ns.
        """
        return self._send(now_ns, STOP)

    def _send(self, now_ns: int, velocity: Velocity) -> Velocity:
        """Logs a command and returns it."""
        self._log.add(now_ns, velocity)
        return velocity

    def _clamped(self, velocity: Velocity) -> Velocity:
        """Returns a velocity within the limits; a stop if it is not finite."""
        if not (math.isfinite(velocity.linear) and math.isfinite(velocity.angular)):
            return STOP
        settings = self.settings
        return Velocity(
            min(max(velocity.linear, -settings.max_linear), settings.max_linear),
            min(max(velocity.angular, -settings.max_angular), settings.max_angular),
        )


class _Search:
    """Rotates a lost robot in place: to the left, to the right, and back; once."""

    def __init__(self, wait: float) -> None:
        self._wait_ns = round(wait * NS_PER_S)
        self.reset()

    def reset(self) -> None:
        """Ends the search; the next one begins anew."""
        self._since_ns: int | None = None
        self._turned = 0.0
        """Heading relative to the start of the search, radians, positive to the left."""
        self._goals = [(_SEARCH_TURN, 1.0), (-_SEARCH_TURN, -1.0), (0.0, 1.0)]
        """Remaining headings relative to the start, radians, and the sign of the rotation towards each."""

    def velocity(self, stamp_ns: int, turn: float) -> Velocity:
        """Returns the velocity of a lost robot.

        Args:
            stamp_ns: stamp of the view, ns.
            turn: turn since the previous view, radians, positive to the left.
        """
        if self._since_ns is None:
            self._since_ns = stamp_ns
        waited_ns = stamp_ns - self._since_ns - self._wait_ns
        if not 0 <= waited_ns <= _SEARCH_NS:
            return STOP
        self._turned += turn
        while self._goals and (self._goals[0][0] - self._turned) * self._goals[0][1] <= 0.0:
            self._goals.pop(0)
        return Velocity(0.0, self._goals[0][1] * _SEARCH_RATE) if self._goals else STOP
