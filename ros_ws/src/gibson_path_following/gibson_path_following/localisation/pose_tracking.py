"""Tracks the pose of a robot in the path frame by a network: which recorded images to compare with a view, and how they correct the filter."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gibson_path_following.errors import SettingError, check_ranges, quoted
from gibson_path_following.localisation.localiser import NodeMatcher
from gibson_path_following.localisation.motions import NS_PER_S
from gibson_path_following.localisation.pose_filter import PoseFilter, node_poses, pose_after_arc
from gibson_path_following.localisation.view_history import ViewHistory
from gibson_path_following.paths.path_geometry import PathGeometry
from gibson_path_following.policies.path_model import PathModel, Prediction
from gibson_path_following.types import Place, RecordedPath, View

F64 = NDArray[np.float64]
_STATION_DEVIATION = 0.12
"""Standard deviation of the localiser's station, metres."""
_MAX_GAP = 1.0
"""Time between two views beyond which the filter begins anew at the localiser's place, seconds."""
_BEHIND = 0.05
"""Distance behind the robot within which a node still counts for the column shift, metres."""


@dataclass(frozen=True, slots=True)
class PoseTrackingSettings:
    """Which recorded images are compared with a view, and when the pose is known."""

    node_lookaheads: tuple[float, ...] = (0.2, 0.5, 0.8, 1.2)
    """Distances ahead along the path of the recorded images that are compared with each view, metres."""
    min_match_probability: float = 0.5
    """Match probability below which the pose of a recorded image is ignored."""
    max_unmatched_views: int = 25
    """Successive views without an accepted measurement after which the pose is unknown; until then it is dead reckoning."""
    max_views_since_match: int = 5
    """Views since the last match up to which the robot is localised."""
    max_lost_views: int = 40
    """Successive views in which the robot is localised although the localiser is lost."""
    max_disagreement: float = 1.5
    """Distance along the path between the station of the localiser and that of the filter beyond which they disagree, metres."""
    disagreement_views: int = 5
    """Successive views of disagreement after which the filter begins anew at the localiser's place."""
    use_column_shift: bool = True
    """Also correct the pose by column shifts against the nodes and by the localiser's place; off = by the network alone."""
    min_shift_score: float = 0.3
    """Score of a column shift below which it is ignored."""
    min_confidence: float = 0.6
    """Confidence of the localiser below which its place is ignored."""

    def __post_init__(self) -> None:
        if not self.node_lookaheads or not all(0.0 <= a <= 3.0 for a in self.node_lookaheads):
            raise SettingError(f"node_lookaheads is {quoted(self.node_lookaheads)}, must be distances of 0 to 3 metres")
        check_ranges(
            self,
            ("min_match_probability", 0.0, 1.0),
            ("max_unmatched_views", 0, 1000),
            ("max_views_since_match", 0, 1000),
            ("max_lost_views", 0, 10000),
            ("max_disagreement", 0.1, 1000.0),
            ("disagreement_views", 1, 1000),
            ("min_shift_score", -1.0, 1.0),
            ("min_confidence", 0.0, 1.0),
        )


@dataclass(frozen=True, slots=True)
class TrackedView:
    """What a view changed."""

    prediction: Prediction
    """Outputs of the network."""
    seconds: float
    """Time since the previous view; 0 for the first one."""
    has_jumped: bool
    """Whether the filter began anew elsewhere on the path, so that maps of the surroundings are wrong."""
    is_known: bool
    """Whether the pose is known: measured, or dead reckoning since not too many views."""


class PoseTracker:
    """Pose of a robot in the path frame, and its station."""

    def __init__(
        self,
        path: RecordedPath,
        model: PathModel,
        settings: PoseTrackingSettings,
        camera_ahead: float,
        nodes: NodeMatcher | None = None,
    ) -> None:
        """Prepares the images of the path.

        Args:
            path: a path of one pinhole camera.
            model: the network.
            settings: how it tracks.
            camera_ahead: distance of the camera ahead of the robot's centre, metres.
            nodes: the nodes of this path, if they are prepared already.
        """
        self.settings, self._model, self._camera_ahead = settings, model, camera_ahead
        self._hfov = path.hfov
        self.images = np.stack([model.resample(node.view[0], path.hfov) for node in path.nodes])
        """(N, height, width, 3), uint8: images of the nodes as the network takes them."""
        distances = np.array([node.distance for node in path.nodes])
        poses = node_poses(path)
        self.geometry = PathGeometry(self._visual_odometry(distances) if poses is None else poses, distances)
        """The path."""
        self._nodes = (nodes or NodeMatcher(path)) if settings.use_column_shift else None
        self.filter = PoseFilter(model.offsets)
        """Pose of the robot, path frame."""
        self.station = 0.0
        """Station of the robot at the newest view, metres."""
        self._history = ViewHistory(camera_ahead)
        self._stamp_ns: int | None = None
        """Stamp of the previous view, ns; None before the first."""
        self._unmatched_views = self._disagreeing_views = self._lost_views = 0
        """Numbers of successive views, see ``PoseTrackingSettings``."""
        self._views_since_match: int | None = None
        """None = no match yet."""

    def reset(self) -> None:
        """Drops all views; the next one begins at the localiser's place."""
        self._history.clear()
        self._stamp_ns = None
        self._unmatched_views = self._disagreeing_views = self._lost_views = 0
        self._views_since_match = None

    @property
    def is_localised(self) -> bool:
        """Whether a recorded image matched recently."""
        since = self._views_since_match
        return (
            since is not None and since <= self.settings.max_views_since_match and self._lost_views < self.settings.max_lost_views
        )

    def update(self, view: View, stamp_ns: int, place: Place) -> TrackedView | None:
        """Predicts and corrects the pose; returns None if neither a previous pose nor the localiser says where the robot is.

        Args:
            view: the images.
            stamp_ns: their stamp, ns.
            place: the localiser's place on the path, and the motion since the previous view.
        """
        settings = self.settings
        localiser_station = self.geometry.station_of(place.index)
        seconds = 0.0 if self._stamp_ns is None else (stamp_ns - self._stamp_ns) / NS_PER_S
        self._lost_views = self._lost_views + 1 if place.is_lost else 0
        if self._stamp_ns is None or seconds > _MAX_GAP:
            self._views_since_match = None
            if place.is_lost:
                return None
            self.filter.reset(self.geometry.pose_at(localiser_station))
            self.station = localiser_station
            self._history.clear()
        else:
            self.filter.predict(place.moved)
            self._history.move(place.moved)
        self._stamp_ns = stamp_ns
        station = self.project()
        disagrees = not place.is_lost and abs(station - localiser_station) > settings.max_disagreement
        self._disagreeing_views = self._disagreeing_views + 1 if disagrees else 0
        has_jumped = self._disagreeing_views >= settings.disagreement_views
        if has_jumped:
            self.filter.reset(self.geometry.pose_at(localiser_station))
            station = self.station = localiser_station
            self._disagreeing_views = 0
        nodes = np.unique([int(np.abs(self.geometry.stations - station - ahead).argmin()) for ahead in settings.node_lookaheads])
        image = self._model.resample(view[0], self._hfov)
        prediction = self._model.estimate(image, self.images[nodes], self._history.earlier())
        self._history.add(image)
        accepted = self._correct_by_network(prediction, nodes, station)
        if accepted:
            self._views_since_match = 0
        elif self._views_since_match is not None:
            self._views_since_match += 1
        if self._nodes is not None:
            accepted = self._correct_by_columns(self._nodes, view, place, localiser_station) or accepted
        self._unmatched_views = 0 if accepted else self._unmatched_views + 1
        return TrackedView(prediction, seconds, has_jumped, self._unmatched_views <= settings.max_unmatched_views)

    def project(self) -> float:
        """Projects the pose onto the path; returns its station, metres."""
        self.station = self.geometry.project(self.filter.pose, self.station)
        return self.station

    def _correct_by_network(self, prediction: Prediction, nodes: NDArray[np.intp], station: float) -> bool:
        """Corrects the pose by the recorded images that match; returns whether one of them passed the gate.

        Args:
            prediction: outputs of the network.
            nodes: (K,), the nodes of its recorded images.
            station: of the robot, metres.
        """
        matches = np.flatnonzero(prediction.match >= self.settings.min_match_probability)
        path_pose = self.geometry.pose_at(station)
        passed = [
            self.filter.correct(
                self.geometry.poses[nodes[k]],
                self._in_robot_frame(prediction.pose[k]),
                prediction.scale[k],
                1.0 / len(matches),
                path_pose,
            )
            for k in matches
        ]
        return any(passed)

    def _correct_by_columns(self, nodes: NodeMatcher, view: View, place: Place, localiser_station: float) -> bool:
        """Corrects the pose by the column shift against the next nodes, and by the localiser; returns whether a shift passed the gate."""
        settings, geometry = self.settings, self.geometry
        if place.confidence >= settings.min_confidence and abs(localiser_station - self.station) < settings.max_disagreement:
            self.filter.correct_station(geometry.pose_at(localiser_station), _STATION_DEVIATION)
        first = int(np.searchsorted(geometry.stations, self.project() - _BEHIND).clip(0, len(geometry.stations) - 1))
        end = min(first + 2, len(geometry.stations))
        matches = nodes.matcher.match(nodes.descriptor(view), first, end)
        return any(
            score >= settings.min_shift_score and self.filter.correct_heading(geometry.poses[first + k], float(turn))
            for k, (score, turn) in enumerate(zip(matches.scores, matches.turns, strict=True))
        )

    def _in_robot_frame(self, pose: F64) -> F64:
        """Returns (3,): pose of the robot that recorded an image, in this robot's frame, from the relative pose (3,) of their cameras."""
        x, y, yaw = (float(value) for value in pose)
        ahead = self._camera_ahead
        return np.array([ahead + x - ahead * math.cos(yaw), y - ahead * math.sin(yaw), yaw])

    def _visual_odometry(self, distances: F64) -> F64:
        """Returns (N, 3), float64: poses of the nodes, path frame, by the turns between successive images, for a path without velocities.

        Args:
            distances: (N,), driven distance up to each node, metres.
        """
        poses = [np.zeros(3)]
        for k in range(len(self.images) - 1):
            turn = float(self._model.estimate(self.images[k], self.images[k + 1 : k + 2]).pose[0, 2])
            x, y, yaw = (float(value) for value in poses[-1])
            poses.append(np.array(pose_after_arc((x, y, yaw), float(distances[k + 1] - distances[k]), turn)))
        return np.array(poses)
