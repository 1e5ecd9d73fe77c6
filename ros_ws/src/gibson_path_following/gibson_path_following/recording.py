"""Records a path from images, commands and, where available, odometry: a node (keyframe) at a distance or turn from the previous one."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections import deque
from dataclasses import dataclass, replace

from gibson_path_following.errors import check_ranges
from gibson_path_following.motions import NS_PER_S, motion_between
from gibson_path_following.types import STOP, CameraKind, PathNode, RecordedPath, Velocity, View

_STANDING = 0.01
"""Distance, metres, and turn, radians, since the first node within which the robot stands."""
Pose = tuple[float, float, float]
"""x, y and yaw, metres and radians."""


@dataclass(frozen=True, slots=True)
class RecorderSettings:
    """When the recorder adds a node."""

    spacing: float = 0.2
    """Distance between nodes, metres."""
    turn: float = 0.35
    """Turn after which a node is added at any distance, radians."""
    interval: float = 0.0
    """Time after which a node is added at any distance, seconds; 0 = never. For images alone."""
    uses_odometry: bool = True
    """Whether distances and turns come from odometry; off = from the commands."""
    odometry_timeout: float = 0.5
    """Time that a view waits for odometry of its stamp, seconds."""

    def __post_init__(self) -> None:
        check_ranges(
            self,
            ("spacing", 0.01, 10.0),
            ("turn", 0.02, 6.3),
            ("interval", 0.0, 3600.0),
            ("odometry_timeout", 0.0, 10.0),
        )


class PathRecorder:
    """Collects the nodes of one path. Not thread-safe."""

    def __init__(self, camera: CameraKind, hfov: float, settings: RecorderSettings | None = None) -> None:
        """Begins without nodes. The first node is the last view before the robot drives.

        Args:
            camera: kind of the camera.
            hfov: horizontal field of view of an image, radians; of a fisheye across its circle.
            settings: None = the defaults.
        """
        self.settings = settings or RecorderSettings()
        self._camera = camera
        self.hfov = hfov
        """Horizontal field of view, radians; it may be set until ``finish``."""
        self._commands: list[tuple[int, Velocity]] = []
        self._odometry: deque[tuple[int, Pose]] = deque(maxlen=1000)
        self._waiting: deque[tuple[int, View]] = deque(maxlen=100)
        self._nodes: list[PathNode] = []
        self._last: tuple[int, View, float, Pose | None] | None = None
        """Stamp, view, distance and pose of the newest view that was used."""
        self._driven = 0.0
        self._turned = 0.0
        """Distance and turn since the newest node, metres and radians."""

    @property
    def nodes(self) -> int:
        """Number of nodes so far."""
        return len(self._nodes)

    @property
    def length(self) -> float:
        """Length of the path so far, metres."""
        return self._last[2] if self._last is not None else 0.0

    def add_command(self, now_ns: int, velocity: Velocity) -> None:
        """Adds a command that holds from ``now_ns`` on; one that is older than the last is dropped."""
        if self._commands and now_ns < self._commands[-1][0]:
            return
        if self._commands and now_ns == self._commands[-1][0]:  # replaced before it took effect
            self._commands.pop()
        if not self._commands or self._commands[-1][1] != velocity:
            self._commands.append((now_ns, velocity))

    def add_odometry(self, stamp_ns: int, pose: Pose) -> None:
        """Adds an odometry pose, odometry frame; one that is not newer than the last is dropped."""
        if self._odometry and stamp_ns <= self._odometry[-1][0]:
            return
        self._odometry.append((stamp_ns, pose))
        self._use_waiting()

    def add_view(self, stamp_ns: int, view: View) -> None:
        """Adds a view; one that is not newer than the previous one is dropped."""
        newest = self._waiting[-1][0] if self._waiting else self._last[0] if self._last is not None else None
        if newest is not None and stamp_ns <= newest:
            return
        self._waiting.append((stamp_ns, view))
        self._use_waiting()

    def finish(self) -> RecordedPath:
        """Returns the path; the newest view is its last node.

        The path may be too short to be followed: ``path_folder.check_path`` checks that.
        """
        while self._waiting:
            self._use(*self._waiting.popleft())
        if self._last is not None and self._last[0] > self._nodes[-1].stamp_ns and self._driven > 0.25 * self.settings.spacing:
            self._add_node(*self._last)
        times = [time_ns for time_ns, _ in self._commands]
        ends = [node.stamp_ns for node in self._nodes[1:]]
        nodes = [
            replace(node, velocities=self._velocities(times, node.stamp_ns, end_ns))
            for node, end_ns in zip(self._nodes, [*ends, None], strict=False)
        ]
        return RecordedPath(self._camera, self.hfov, tuple(nodes), self.settings.spacing)

    def _use_waiting(self) -> None:
        timeout_ns = round(self.settings.odometry_timeout * NS_PER_S)
        while self._waiting:
            stamp_ns = self._waiting[0][0]
            is_late = self._waiting[-1][0] - stamp_ns >= timeout_ns
            if self.settings.uses_odometry and not is_late and (not self._odometry or self._odometry[-1][0] < stamp_ns):
                return
            self._use(*self._waiting.popleft())

    def _use(self, stamp_ns: int, view: View) -> None:
        pose = self._pose(stamp_ns) if self.settings.uses_odometry else None
        if self._last is None:
            if pose is None and self._odometry:  # of before the first odometry: the path begins with the next view
                return
            self._last = (stamp_ns, view, 0.0, pose)
            self._add_node(*self._last)
            return
        before_ns, _, distance, before = self._last
        if pose is not None and before is not None:
            step = math.hypot(pose[0] - before[0], pose[1] - before[1])
            turn = abs(math.remainder(pose[2] - before[2], math.tau))
        else:
            driven = motion_between(self._commands, before_ns, stamp_ns)
            step, turn = abs(driven.distance), abs(driven.turn)
        self._driven, self._turned = self._driven + step, self._turned + turn
        is_due = 0.0 < self.settings.interval * NS_PER_S <= stamp_ns - self._nodes[-1].stamp_ns
        stands = len(self._nodes) == 1 and self._driven < _STANDING and self._turned < _STANDING
        if stands and self.settings.interval == 0.0:  # the path has not begun
            self._last = (stamp_ns, view, 0.0, pose)
            self._nodes.clear()
            self._add_node(*self._last)
            return
        self._last = (stamp_ns, view, distance + step, pose)
        # Rounded to the nearest view: half a step early is nearer than half a step late.
        if is_due or self._driven + step / 2.0 >= self.settings.spacing or self._turned + turn / 2.0 >= self.settings.turn:
            self._add_node(*self._last)

    def _add_node(self, stamp_ns: int, view: View, distance: float, pose: Pose | None) -> None:
        self._nodes.append(PathNode(view, stamp_ns, distance, (), pose))
        self._driven = self._turned = 0.0

    def _pose(self, stamp_ns: int) -> Pose | None:
        """Returns the odometry pose at a time, ns, interpolated; None = no odometry within the timeout."""
        stamps = [stamp for stamp, _ in self._odometry]
        after = bisect_right(stamps, stamp_ns)
        if after == 0:
            return None
        begin_ns, begin = self._odometry[after - 1]
        if begin_ns == stamp_ns or after == len(stamps):
            return begin if stamp_ns - begin_ns <= self.settings.odometry_timeout * NS_PER_S else None
        end_ns, end = self._odometry[after]
        share = (stamp_ns - begin_ns) / (end_ns - begin_ns)
        yaw = begin[2] + share * math.remainder(end[2] - begin[2], math.tau)
        return begin[0] + share * (end[0] - begin[0]), begin[1] + share * (end[1] - begin[1]), math.remainder(yaw, math.tau)

    def _velocities(self, times: list[int], stamp_ns: int, end_ns: int | None) -> tuple[tuple[int, Velocity], ...]:
        """Returns the command in effect at a node and those up to the next node, each with its time after the stamp of the node, ns.

        Args:
            times: of all commands, ns.
            stamp_ns: stamp of the node, ns.
            end_ns: stamp of the next node, ns; None = there is none.
        """
        if not times:
            return ()
        first = bisect_right(times, stamp_ns)
        last = first if end_ns is None else bisect_left(times, end_ns)
        held = self._commands[first - 1][1] if first else STOP
        return ((0, held), *((time_ns - stamp_ns, velocity) for time_ns, velocity in self._commands[first:last]))
