"""Records a path from images, commands and, where available, odometry: a node (keyframe) at a distance or turn from the previous one."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace

from gibson_path_following.errors import check_ranges
from gibson_path_following.localisation.motions import NS_PER_S, motion_between
from gibson_path_following.paths.path_folder import MAX_NODES, MAX_VALUE, MAX_VELOCITIES
from gibson_path_following.paths.stamp_filter import StampFilter, outlier_line
from gibson_path_following.types import STOP, CameraKind, PathNode, RecordedPath, Velocity, View

_STANDING = 0.01
"""Distance, metres, and turn, radians, since the first node within which the robot stands."""
_MAX_COMMAND = 100.0
"""Largest command that counts, m/s and rad/s."""
_MAX_SPEED = 10.0
"""Speed by odometry from which on it has jumped, m/s."""
_MIN_JUMP = 0.5
"""Step that late odometry explains at any speed, metres."""
_PATIENCE_NS = 5_000_000_000
"""Time without odometry and commands from which on a warning is due, ns."""
_OTHER_TIMES = "cmd_vel came at other times than the images; set use_sim_time as the node of the camera has it"
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

    def __init__(
        self, camera: CameraKind, hfov: float, settings: RecorderSettings | None = None, *,
        max_nodes: int = MAX_NODES, warn: Callable[[str], None] | None = None,
    ) -> None:  # fmt: skip
        """Begins without nodes. The first node is the last view before the robot drives.

        Args:
            camera: kind of the camera.
            hfov: horizontal field of view of an image, radians; of a fisheye across its circle.
            settings: None = the defaults.
            max_nodes: number of nodes from which on the path is full, as of ``path_folder.max_nodes``.
            warn: gets a line about what is not as it should be, once each; None = none is wanted.
        """
        self.settings = settings or RecorderSettings()
        self._camera = camera
        self.hfov = hfov
        """Horizontal field of view, radians; it may be set until ``finish``."""
        self._commands: list[tuple[int, Velocity]] = []
        self._odometry: deque[tuple[int, Pose]] = deque(maxlen=1000)
        self._odometry_stamps: StampFilter[Pose] = StampFilter()
        self._max_nodes = max_nodes
        self._warn, self._warned = warn, set[str]()
        self._has_odometry = self._has_bad_odometry = self._has_commands = False
        """Whether odometry has come that can be used, some that cannot, and commands that can."""
        self._first_ns: int | None = None
        """Stamp of the first view, ns."""
        self._views = 0
        """Number of views that were used."""
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

    @property
    def is_full(self) -> bool:
        """Whether the path has as many nodes or commands as can be read."""
        return len(self._nodes) >= self._max_nodes or len(self._commands) + len(self._nodes) >= MAX_VELOCITIES

    def add_command(self, now_ns: int, velocity: Velocity | None) -> None:
        """Adds a command that holds from ``now_ns`` on; one that is older than the last, or that no robot can follow, is dropped.

        Args:
            now_ns: time of the command, ns, of the clock of the images.
            velocity: None = it is not finite.
        """
        if velocity is None or not max(abs(velocity.linear), abs(velocity.angular)) <= _MAX_COMMAND:
            self._warn_once(f"a command is not finite, or above {_MAX_COMMAND:g} m/s or rad/s: it is left out", "command")
            return
        self._has_commands = True
        if self.is_full:
            return
        if self._commands and now_ns < self._commands[-1][0]:
            return
        if self._commands and now_ns == self._commands[-1][0]:  # replaced before it took effect
            self._commands.pop()
        if not self._commands or self._commands[-1][1] != velocity:
            self._commands.append((now_ns, velocity))

    def add_odometry(self, stamp_ns: int, pose: Pose | None) -> None:
        """Adds an odometry pose, odometry frame; one that is not newer than the last, and a single one of another time, are dropped.

        Args:
            stamp_ns: its stamp, ns.
            pose: None = it has no finite position, or no rotation.
        """
        if pose is None or not max(map(abs, pose)) <= MAX_VALUE:
            self._warn_once(
                f"a message of odom has no rotation, or no position within {MAX_VALUE:g} m: it is left out; correct its driver",
                "pose",
            )
            self._has_bad_odometry = True
            return
        self._has_odometry = True
        passed = self._odometry_stamps.add(stamp_ns, pose)
        if passed.outlier_ns is not None:
            self._warn_once(f"odom: {outlier_line(passed.outlier_ns)}", "odometry")
        if passed.is_jump:
            self._use_waiting(at_once=True)
            self._odometry.clear()
        self._odometry.extend(passed.items)
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
        self._use_waiting(at_once=True)
        if (
            not self.is_full
            and self._last is not None
            and self._last[0] > self._nodes[-1].stamp_ns
            and self._driven > 0.25 * self.settings.spacing
        ):
            self._add_node(*self._last)
        times = [time_ns for time_ns, _ in self._commands]
        ends = [node.stamp_ns for node in self._nodes[1:]]
        nodes = [
            replace(node, velocities=self._velocities(times, node.stamp_ns, end_ns))
            for node, end_ns in zip(self._nodes, [*ends, None], strict=False)
        ]
        return RecordedPath(self._camera, self.hfov, tuple(nodes), self.settings.spacing)

    def missing(self) -> str:
        """Returns why there are fewer than 2 nodes, and the remedy."""
        if self._views < 2:
            return f"the number of images is {self._views}; record for longer"
        if not (self._has_odometry or self._has_commands):
            unusable = (
                "odom has no usable pose, and no cmd_vel has come"
                if self._has_bad_odometry
                else "neither odom nor cmd_vel has come"
            )
            none = unusable if self.settings.uses_odometry else "no cmd_vel has come"
            return f"{none}, so that no distance is known; check the topics, or set interval for images alone"
        if self._has_odometry and not (self._nodes and self._nodes[0].pose):
            return self._without_poses()
        if self._last is not None and self._commands and self._commands[0][0] > self._last[0]:
            return _OTHER_TIMES
        by = "odom" if self._has_odometry and self.settings.uses_odometry else "cmd_vel"
        return f"the robot has not driven {self.settings.spacing:g} m by {by}; drive on while it records"

    def remarks(self, path: RecordedPath) -> tuple[str, ...]:
        """Returns what a path of this recording lacks, a phrase each."""
        found = []
        if self.settings.uses_odometry and path.nodes[0].pose is None:
            found.append(self._without_poses())
        if path.length > 0.0 and not any(v != STOP for node in path.nodes for _, v in node.velocities):
            found.append(f"all its velocities are 0: {_OTHER_TIMES if self._has_commands else 'no cmd_vel has come'}")
        return tuple(found)

    def _use_waiting(self, *, at_once: bool = False) -> None:
        """Uses the views whose odometry has come or is late; with ``at_once`` all."""
        timeout_ns = round(self.settings.odometry_timeout * NS_PER_S)
        while self._waiting:
            stamp_ns = self._waiting[0][0]
            is_late = at_once or self._waiting[-1][0] - stamp_ns >= timeout_ns
            if self.settings.uses_odometry and not is_late and (not self._odometry or self._odometry[-1][0] < stamp_ns):
                return
            self._use(*self._waiting.popleft())

    def _use(self, stamp_ns: int, view: View) -> None:
        if self.is_full:
            return
        pose = self._pose(stamp_ns) if self.settings.uses_odometry else None
        self._views += 1
        self._first_ns = stamp_ns if self._first_ns is None else self._first_ns
        if self._last is None:
            if pose is None and self._odometry:  # of before the first odometry: the path begins with the next view
                if stamp_ns - self._first_ns > _PATIENCE_NS:
                    self._warn_once(f"no node is recorded: {self._without_poses()}", "missing")
                return
            self._last = (stamp_ns, view, 0.0, pose)
            self._add_node(*self._last)
            return
        before_ns, _, distance, before = self._last
        step, turn = self._motion(before_ns, before, stamp_ns, pose)
        self._driven, self._turned = self._driven + step, self._turned + turn
        is_due = 0.0 < self.settings.interval * NS_PER_S <= stamp_ns - self._nodes[-1].stamp_ns
        stands = len(self._nodes) == 1 and self._driven < _STANDING and self._turned < _STANDING
        if stands and self.settings.interval == 0.0:  # the path has not begun
            if not (self._has_odometry or self._has_commands) and stamp_ns - self._first_ns > _PATIENCE_NS:
                self._warn_once(self.missing(), "missing")
            self._last = (stamp_ns, view, 0.0, pose)
            self._nodes.clear()
            self._add_node(*self._last)
            self._drop_commands(stamp_ns)
            return
        self._last = (stamp_ns, view, distance + step, pose)
        # Rounded to the nearest view: half a step early is nearer than half a step late.
        if is_due or self._driven + step / 2.0 >= self.settings.spacing or self._turned + turn / 2.0 >= self.settings.turn:
            self._add_node(*self._last)

    def _motion(self, before_ns: int, before: Pose | None, stamp_ns: int, pose: Pose | None) -> tuple[float, float]:
        """Returns distance, metres, and turn, radians, between two views: by odometry, or by the commands where it is missing or has jumped."""
        if pose is not None and before is not None:
            step = math.hypot(pose[0] - before[0], pose[1] - before[1])
            seconds = (stamp_ns - before_ns) / NS_PER_S
            if step <= max(_MIN_JUMP, _MAX_SPEED * seconds):
                return step, abs(math.remainder(pose[2] - before[2], math.tau))
            self._warn_once(
                f"odometry has jumped by {step:g} m within {seconds:.2f} s: the distance there is that of the commands, and the poses of the "
                "path do not fit together; use odometry that does not jump (odom, not map)",
                "jump",
            )
        driven = motion_between(self._commands, before_ns, stamp_ns)
        return abs(driven.distance), abs(driven.turn)

    def _drop_commands(self, stamp_ns: int) -> None:
        """Drops the commands that ended before a time, ns."""
        del self._commands[: max(0, bisect_right(self._commands, stamp_ns, key=lambda each: each[0]) - 1)]

    def _warn_once(self, line: str, kind: str) -> None:
        if self._warn is not None and kind not in self._warned:
            self._warn(line)
        self._warned.add(kind)

    def _add_node(self, stamp_ns: int, view: View, distance: float, pose: Pose | None) -> None:
        self._nodes.append(PathNode(view, stamp_ns, distance, (), pose))
        self._driven = self._turned = 0.0
        if len(self._nodes) == 2 and pose is None and self.settings.uses_odometry and self.settings.interval == 0.0:
            self._warn_once(f"{self._without_poses()}: distances are those of the commands, and the path has no poses", "poses")

    def _without_poses(self) -> str:
        if self._has_odometry:
            return "the stamps of odom are not those of the images; set use_sim_time for all nodes or for none, and synchronise the clocks"
        return "odom has no usable pose" if self._has_bad_odometry else "no odom has come"

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
