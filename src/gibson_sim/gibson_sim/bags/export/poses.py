"""Poses of the cameras of a bag, from the states of a simulation or from tf."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from gibson_sim.bags.export.read import ExportCamera
from gibson_sim.bags.reader import BagReader
from gibson_sim.bags.rerender import SCENE_TYPE, STATE_TYPE
from gibson_sim.bags.stamps import time_from_msg
from gibson_sim.errors import RecordError
from gibson_sim.geometry.interpolation import slerp
from gibson_sim.geometry.transforms import Mat4, matrix_from_pose, matrix_from_quat
from gibson_sim.types import Pose

_TF_TYPE = "tf2_msgs/msg/TFMessage"
_FIXED_FRAMES = ("map", "odom", "world")
"""Frames that poses may be in, in order of preference."""
_MOST_LINKS = 100
"""Maximum length of a chain of frames; a longer one is a loop."""


class PoseSource(Protocol):
    """Source of camera poses."""

    @property
    def text(self) -> str:
        """Name of the source for the user."""

    def pose(self, camera: ExportCamera, stamp_ns: int) -> Mat4 | None:
        """Returns T_world_camera of the optical frame, (4, 4); None = unknown at this time."""


@dataclass(slots=True)
class PoseTrack:
    """Poses of one frame over time."""

    stamps: list[int] = field(default_factory=list)
    rows: list[NDArray[np.float64]] = field(default_factory=list)
    """Position x y z (metres) and quaternion qx qy qz qw."""
    _arrays: tuple[NDArray[np.int64], NDArray[np.float64]] | None = None

    def add(self, stamp_ns: int, row: NDArray[np.float64]) -> None:
        """Adds a pose."""
        self.stamps.append(stamp_ns)
        self.rows.append(row)
        self._arrays = None

    def at(self, stamp_ns: int) -> Mat4 | None:
        """Returns the pose at a time, (4, 4), interpolated; None before the first and after the last."""
        if self._arrays is None:
            order = np.argsort(np.array(self.stamps, dtype=np.int64), kind="stable")
            self._arrays = np.array(self.stamps, dtype=np.int64)[order], np.array(self.rows)[order]
        stamps, rows = self._arrays
        at = int(np.searchsorted(stamps, stamp_ns))
        if at < len(stamps) and stamps[at] == stamp_ns:
            return _matrix(rows[at])
        if at in (0, len(stamps)):
            return None
        fraction = (stamp_ns - int(stamps[at - 1])) / (int(stamps[at]) - int(stamps[at - 1]))
        row = rows[at - 1] + fraction * (rows[at] - rows[at - 1])
        row[3:] = slerp(rows[at - 1, 3:], rows[at, 3:], fraction)
        return _matrix(row)


def _matrix(row: NDArray[np.float64]) -> Mat4:
    matrix: Mat4 = np.eye(4)
    matrix[:3, :3] = matrix_from_quat(row[3:] / np.linalg.norm(row[3:]))
    matrix[:3, 3] = row[:3]
    return matrix


class StatePoses:
    """Ground truth: poses of links in ``scene_state`` with the mounts of cameras in ``scene``."""

    def __init__(self, bag: BagReader, scene_topic: str, state_topic: str) -> None:
        self.text = f"{state_topic} (ground truth)"
        self._mounts: dict[str, tuple[str, Mat4]] = {}
        self._frames: dict[str, list[str]] = {}
        links: dict[int, Sequence[str]] = {}
        for _, _, msg in bag.messages([scene_topic]):
            links[msg.revision] = msg.links
            for camera in msg.cameras:
                p, q = camera.pose.position, camera.pose.orientation
                mount = matrix_from_pose(Pose((p.x, p.y, p.z), (q.x, q.y, q.z, q.w)))
                self._mounts[camera.name] = ("" if camera.link < 0 else msg.links[camera.link], mount)
                if camera.name not in self._frames.setdefault(camera.frame_id, []):
                    self._frames[camera.frame_id].append(camera.name)
        mount_links = {link for link, _ in self._mounts.values()}
        self._tracks: dict[str, PoseTrack] = {link: PoseTrack() for link in mount_links}
        for _, _, msg in bag.messages([state_topic]):
            stamp = time_from_msg(msg.header.stamp)
            for row, link in zip(msg.poses.reshape(-1, 7), links.get(msg.revision, ()), strict=False):
                if link in mount_links:
                    self._tracks[link].add(stamp, row)

    def has(self, camera: ExportCamera) -> bool:
        """Whether the scene has this camera."""
        return self._name(camera) is not None

    def _name(self, camera: ExportCamera) -> str | None:
        if camera.path in self._mounts:
            return camera.path
        names = self._frames.get(camera.frame_id, [])
        return names[0] if len(names) == 1 else None

    def pose(self, camera: ExportCamera, stamp_ns: int) -> Mat4 | None:
        """Returns T_world_camera; exact at the stamps of states."""
        name = self._name(camera)
        if name is None:
            return None
        link, T_link_camera = self._mounts[name]
        T_world_link = self._tracks[link].at(stamp_ns) if link else np.eye(4)
        return None if T_world_link is None else T_world_link @ T_link_camera


class TransformPoses:
    """Poses from ``/tf`` and ``/tf_static``.

    Args:
        bag: the bag.
        fixed: frame of the poses; empty = the first of map, odom and world that is an ancestor of the camera.
        prefix: namespace whose transform topics are read in addition to the global ones.
    """

    def __init__(self, bag: BagReader, fixed: str, prefix: str = "") -> None:
        self._fixed = fixed
        self._parents: dict[str, str] = {}
        self._fixed_poses: dict[str, Mat4] = {}
        self._tracks: dict[str, PoseTrack] = {}
        topics = [
            topic
            for topic, info in bag.topics().items()
            if info.type_name == _TF_TYPE and info.count and f"{prefix}/".startswith(topic.rpartition("/")[0] + "/")
        ]
        for topic, _, msg in bag.messages(topics) if topics else ():
            for transform in msg.transforms:
                self._add(transform, is_static=topic.endswith("tf_static"))
        self.text = f"{' and '.join(topics)}" if topics else "nowhere"

    def _add(self, msg: Any, *, is_static: bool) -> None:
        child = msg.child_frame_id.strip("/")
        self._parents[child] = msg.header.frame_id.strip("/")
        t, r = msg.transform.translation, msg.transform.rotation
        row = np.array([t.x, t.y, t.z, r.x, r.y, r.z, r.w])
        if is_static:
            self._fixed_poses[child] = _matrix(row)
        else:
            self._tracks.setdefault(child, PoseTrack()).add(time_from_msg(msg.header.stamp), row)

    def fixed_frame(self, camera: ExportCamera) -> str:
        """Returns the frame of the camera's poses; empty = tf does not have the camera."""
        chain = self._chain(camera.frame_id.strip("/"))
        if len(chain) < 2:
            return ""
        candidates = (self._fixed,) if self._fixed else _FIXED_FRAMES
        return next((frame for frame in candidates if frame in chain), "" if self._fixed else chain[-1])

    def _chain(self, frame: str) -> list[str]:
        """Returns a frame and its ancestors."""
        chain = [frame]
        while chain[-1] in self._parents and len(chain) < _MOST_LINKS:
            chain.append(self._parents[chain[-1]])
        return chain

    def pose(self, camera: ExportCamera, stamp_ns: int) -> Mat4 | None:
        """Returns T_fixed_camera; None if a transform is unknown at this time."""
        fixed = self.fixed_frame(camera)
        if not fixed:
            return None
        matrix: Mat4 = np.eye(4)
        for frame in self._chain(camera.frame_id.strip("/")):
            if frame == fixed:
                return matrix
            step = self._fixed_poses.get(frame) if frame in self._fixed_poses else self._tracks[frame].at(stamp_ns)
            if step is None:
                return None
            matrix = step @ matrix
        return None


class Poses:
    """Chooses the source of each camera's poses.

    Args:
        bag: the bag.
        source: ``auto`` = states of a simulation if its scene has the camera, else tf; ``scene`` or ``tf`` = only that source.
        fixed: see ``TransformPoses``.
    """

    def __init__(self, bag: BagReader, source: str = "auto", fixed: str = "") -> None:
        self._bag, self._fixed = bag, fixed
        topics = {info.type_name: topic for topic, info in bag.topics().items() if info.count}
        has_states = SCENE_TYPE in topics and STATE_TYPE in topics
        if source == "scene" and not has_states:
            raise RecordError(f"bag {bag.folder} has no /scene and /scene_state: use --poses tf, or record both topics")
        self._states = StatePoses(bag, topics[SCENE_TYPE], topics[STATE_TYPE]) if has_states and source != "tf" else None
        self._source = source
        self._trees: dict[str, TransformPoses] = {}

    def of(self, camera: ExportCamera) -> PoseSource | None:
        """Returns the source of the camera's poses; None = the bag has none."""
        if self._states is not None and self._states.has(camera) and self._fixed in ("", "map"):
            return self._states
        if self._source == "scene":
            return None
        prefix = "/" + camera.path.partition("/")[0]
        if prefix not in self._trees:
            self._trees[prefix] = TransformPoses(self._bag, self._fixed, prefix)
        tree = self._trees[prefix]
        return tree if tree.fixed_frame(camera) else None
