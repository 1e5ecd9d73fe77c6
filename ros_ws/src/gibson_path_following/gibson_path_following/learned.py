"""Follows a path with a network that was trained in simulation: where the recorded images ahead are from here, and how far the floor is free.

The network perceives; where to drive is geometry: a map of what stands around (``occupancy.py``), a way along the path round it
(``lattice.py``), arcs that follow the way (``arcs.py``), and what to do where there is none (``recovery.py``). It needs onnxruntime, and no PyTorch.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_path_following.arcs import ArcPlanner, ArcSettings
from gibson_path_following.errors import ModelError, SettingError, ViewError, check_ranges, quoted
from gibson_path_following.floor_plane import FloorPlane, ViewTrack
from gibson_path_following.lattice import Lattice, LatticeSettings, Way
from gibson_path_following.localisation import NodeMatcher
from gibson_path_following.motions import NS_PER_S, Motion, segments
from gibson_path_following.occupancy import OccupancyGrid, OccupancySettings
from gibson_path_following.onnx_files import open_session, run
from gibson_path_following.pose_filter import OffsetTold, PoseFilter, moved, node_poses, relative
from gibson_path_following.recovery import Recovery, RecoverySettings
from gibson_path_following.types import STOP, Image, Place, RecordedPath, Step, Velocity, View

F64 = NDArray[np.float64]
DEFAULT_MODEL = Path(__file__).with_name("models") / "path_following.onnx"
"""The network in the package."""
_TURN_METRES = 0.3
"""Distance that a radian of heading counts as, metres, where two parts of a path are near."""
_IN_PLACE = 0.05
"""Distance between two nodes below which the robot that recorded them turned in place, metres."""
_PIVOT = 1.0
"""Turn in place from which on the robot drives to where it was made, and makes it there, radians: smaller ones are rounded."""
_AT_PIVOT = 0.05
"""Distance to that place, along the path, at which it begins to turn, metres."""
_JUMP = 0.2
"""Distance that a metre along the path counts as, beyond the first metre from where the robot was."""
_PLACE_DEVIATION = 0.12
"""Standard deviation of the localiser's place along the path, metres."""
_OVERSHOOT = 0.1
"""Distance beyond the end of the path at which the robot stops by itself, metres."""
_LONG_AGO = 1.0
"""Time between two views after which the filter begins anew where the localiser says, seconds: the robot was lost meanwhile."""
_CHORD = 0.15
"""Half the length of the chord whose direction is that of the path, metres: recorded turns are sharp."""
_BEHIND = 0.2
"""Distance behind the robot that must be free where it backs off, metres."""
_SLOW_AHEAD = 0.5
"""Distance along the path ahead whose clearance limits the speed, metres."""
_INPUTS = ("present", "recorded", "earlier")
"""Of the network; the last one may be missing."""
_OUTPUTS = ("pose", "scale", "match", "hit")
_METADATA = ("hfov_deg", "free_edges", "offset_ratio", "offset_deviation")
"""Of the network's file."""
_CAMERA_HEIGHT = "camera_height"
"""Metadata of a file whose network sees an earlier image."""


@dataclass(frozen=True, slots=True)
class Sighting:
    """What the network tells about a view."""

    pose: F64
    """(K, 3): the recorded cameras in the frame of the present one: x ahead, y to the left, yaw; metres and radians."""
    scale: F64
    """(K, 3): mean absolute errors that it expects."""
    match: F64
    """(K,): probability that a recorded image shows this place, so that its pose means something."""
    hit: F64
    """(D, B + 1): probability that the first thing in each of the directions ``PathModel.bearings`` stands in each bin of
    ``PathModel.edges``; the last: farther than all."""


class PathModel:
    """The network in a file, run on one core."""

    def __init__(self, file: Path) -> None:
        """Loads the network.

        Raises:
            ModelError: onnxruntime is not installed, or the file holds no such network.
        """
        self._file, self._session = file, open_session(file)
        self._check(file)
        needed = (*_METADATA, _CAMERA_HEIGHT) if len(self._session.get_inputs()) == len(_INPUTS) else _METADATA
        _, self.height, self.width, _ = self._session.get_inputs()[0].shape
        metadata: dict[str, str] = self._session.get_modelmeta().custom_metadata_map
        try:
            self.hfov = math.radians(float(metadata["hfov_deg"]))
            """Horizontal field of view that it was trained for, radians."""
            self.edges: F64 = np.array([float(edge) for edge in metadata["free_edges"].split(",")])
            """(B + 1,), edges of the bins of free distances, metres, from 0."""
            self.offsets = OffsetTold(float(metadata["offset_ratio"]), float(metadata["offset_deviation"]))
            """How the offsets that it tells relate to the true ones."""
            camera_height = float(metadata[_CAMERA_HEIGHT]) if _CAMERA_HEIGHT in needed else None
        except (KeyError, ValueError) as error:
            raise ModelError(f"{file}: its metadata lack one of {', '.join(needed)} as numbers; export it anew") from error
        count, bins = self._session.get_outputs()[3].shape
        if bins != len(self.edges) or self.edges[0] != 0.0 or not (np.diff(self.edges) > 0.0).all():
            raise ModelError(
                f"{file}: its free_edges are {len(self.edges)} numbers, must be {bins} that grow from 0 m; export it anew"
            )
        if not (0.05 <= self.offsets.ratio <= 2.0 and 0.0 <= self.offsets.deviation <= 10.0):
            raise ModelError(
                f"{file}: its offset_ratio is {self.offsets.ratio:g} and its offset_deviation {self.offsets.deviation:g}, must be 0.05 to 2 "
                "and 0 to 10 m; export it anew"
            )
        if camera_height is not None and not 0.01 <= camera_height <= 100.0:
            raise ModelError(f"{file}: its {_CAMERA_HEIGHT} is {camera_height:g}, must be 0.01 to 100 m; export it anew")
        self._floor = None if camera_height is None else FloorPlane(self.width, self.height, self.hfov, camera_height)
        """Brings earlier images onto the present one; None = the network sees none."""
        across = 1.0 - (np.arange(count) + 0.5) * 2.0 / count
        self.bearings: F64 = np.arctan(across * math.tan(self.hfov / 2.0))
        """Directions of the free distances, radians, positive to the left, left first."""

    def estimate(self, present: Image, recorded: NDArray[np.uint8], earlier: tuple[Image, F64] | None = None) -> Sighting:
        """Returns what the network tells.

        Args:
            present: image of the model's size and field of view, as ``fitted`` returns it.
            recorded: (K, height, width, 3).
            earlier: an image of the same camera a little way before, and where it was then, (3,), in the frame of the present camera, metres and
                radians; None = unknown.

        Raises:
            ModelError: the network cannot be run.
        """
        images = {"present": present[None], "recorded": recorded}
        if self._floor is not None:
            before = np.zeros_like(present) if earlier is None else self._floor.brought(*earlier)
            images["earlier"] = before[None]
        values = run(self._session, self._file, images)
        return Sighting(*(np.asarray(value, dtype=np.float64) for value in values))

    def fitted(self, image: Image, hfov: float) -> Image:
        """Returns an image as the camera that the network was trained for would see it.

        Args:
            image: of a pinhole camera with square pixels.
            hfov: its horizontal field of view, radians.
        """
        height, width = image.shape[:2]
        scale = (self.width / math.tan(self.hfov / 2.0)) / (width / math.tan(hfov / 2.0))
        if (width, height) == (self.width, self.height) and abs(scale - 1.0) < 0.02:
            return np.ascontiguousarray(image)
        size = max(1, round(width * scale)), max(1, round(height * scale))
        shrunk = cv2.resize(image, size, interpolation=cv2.INTER_AREA if scale < 1.0 else cv2.INTER_LINEAR)
        # What is beyond the image's edge repeats the edge.
        across, down = max(0, self.width - size[0]), max(0, self.height - size[1])
        sides = (down // 2, down - down // 2, across // 2, across - across // 2)
        wide = cv2.copyMakeBorder(shrunk, *sides, cv2.BORDER_REPLICATE)
        top, left = (wide.shape[0] - self.height) // 2, (wide.shape[1] - self.width) // 2
        return np.ascontiguousarray(wide[top : top + self.height, left : left + self.width], dtype=np.uint8)

    def _check(self, file: Path) -> None:
        inputs, outputs = self._session.get_inputs(), self._session.get_outputs()
        names = tuple(i.name for i in inputs), tuple(o.name for o in outputs)
        if names not in ((_INPUTS, _OUTPUTS), (_INPUTS[:2], _OUTPUTS)):
            raise ModelError(
                f"{file}: its inputs are {', '.join(names[0])} and its outputs {', '.join(names[1])}; must be "
                f"{', '.join(_INPUTS)} (the last one may be missing) and {', '.join(_OUTPUTS)}: use a file that gibson-sim learn path-following wrote"
            )
        if not all(_is_image(each.shape) for each in (inputs[0], *inputs[2:])) or not _is_fixed(outputs[3].shape, 2):
            raise ModelError(
                f"{file}: its images have shape {inputs[0].shape}, hit has {outputs[3].shape}; must be (1, height, width, 3) and "
                "(directions, bins), with fixed sizes"
            )


@dataclass(frozen=True, slots=True)
class LearnedSettings:
    """Which recorded images are looked for, and how the robot drives."""

    looked_for: tuple[float, ...] = (0.2, 0.5, 0.8, 1.2)
    """Recorded images that are compared with each view: distances ahead along the path, metres."""
    ahead: float = 0.35
    """Distance along the path of the place that the robot goes for, metres."""
    least_match: float = 0.5
    """Probability below which a recorded image is not seen."""
    camera_ahead: float = 0.12
    """Of the camera in front of the middle of the robot, metres."""
    speed_ratio: float = 1.0
    """Largest speed, as a multiple of the recorded one there."""
    usual_linear: float = 0.3
    """Recorded speed where the path has none, m/s."""
    least_linear: float = 0.15
    """Speed below which the recorded one does not limit, m/s."""
    unseen_views: int = 25
    """Views in a row in which no recorded image is seen, after which the robot stops; until then it goes by what it drove."""
    sure_views: int = 5
    """Views since one in which a recorded image was seen, up to which the policy is sure where it is."""
    lost_views: int = 40
    """Views in a row in which it drives on where the localiser is lost, as long as it is sure."""
    far_off: float = 1.5
    """Distance along the path between the localiser's place and the network's at which they disagree, metres."""
    far_off_views: int = 5
    """Views in a row in which they disagree, after which the network begins anew at the localiser's place."""
    columns: bool = True
    """Also correct the pose by the columns that the view is shifted against recorded ones, and by the localiser's place; off = by the
    network alone."""
    least_score: float = 0.3
    """Score of such a shift below which it tells nothing."""
    least_confidence: float = 0.6
    """Confidence of the localiser below which its place tells nothing."""
    slow: float = 0.12
    """Speed where the way is as narrow as the robot can pass, or where the last view shows that something may stand on it, m/s."""
    careful: float = 1.0
    """Distance along the way ahead within which such a thing slows the robot, metres: the nearer it comes, the more views it has."""
    doubts: tuple[float, float] = (0.25, 0.6)
    """Probability of such a thing from which on the robot drives slower, and that at which it drives at ``slow``."""
    near_views: int = 8
    """Views in a row for which the robot stands before what seems nearer than ``OccupancySettings.min_range``: people walk on, and what the
    network sees there is mostly nothing."""
    stop_before: float = 0.2
    """Distance to where the way is blocked at which the robot stops, metres."""
    occupancy: OccupancySettings = field(default_factory=OccupancySettings)
    """The map of what stands around."""
    lattice: LatticeSettings = field(default_factory=LatticeSettings)
    """The way along the path, round what stands on it."""
    arcs: ArcSettings = field(default_factory=ArcSettings)
    """How the way is followed."""
    recovery: RecoverySettings = field(default_factory=RecoverySettings)
    """What is done where there is no way."""

    def __post_init__(self) -> None:
        if not self.looked_for or not all(0.0 <= a <= 3.0 for a in self.looked_for):
            raise SettingError(f"looked_for is {quoted(self.looked_for)}, must be distances of 0 to 3 metres")
        if not (len(self.doubts) == 2 and 0.0 <= self.doubts[0] <= self.doubts[1] <= 1.0):
            raise SettingError(f"doubts is {quoted(self.doubts)}, must be two probabilities, the smaller one first")
        check_ranges(
            self,
            ("ahead", 0.05, 3.0),
            ("least_match", 0.0, 1.0),
            ("camera_ahead", -5.0, 5.0),
            ("speed_ratio", 0.1, 10.0),
            ("usual_linear", 0.01, 10.0),
            ("least_linear", 0.0, 10.0),
            ("unseen_views", 0, 1000),
            ("sure_views", 0, 1000),
            ("lost_views", 0, 10000),
            ("least_score", -1.0, 1.0),
            ("least_confidence", 0.0, 1.0),
            ("far_off", 0.1, 1000.0),
            ("far_off_views", 1, 1000),
            ("near_views", 0, 1000),
            ("slow", 0.01, 10.0),
            ("careful", 0.0, 10.0),
            ("stop_before", 0.0, 5.0),
        )


class LearnedPolicy:
    """A ``Policy`` with a network: it sees where beside its path the robot is, and what is free."""

    def __init__(
        self,
        path: RecordedPath,
        model: Path | PathModel = DEFAULT_MODEL,
        settings: LearnedSettings | None = None,
        nodes: NodeMatcher | None = None,
    ) -> None:
        """Loads the network and prepares the images of the path.

        Args:
            path: a path of one pinhole camera.
            model: the network, or its file.
            settings: None = the defaults.
            nodes: the nodes of this path, if they are prepared already.

        Raises:
            ModelError: the network cannot be used.
            ViewError: the path is of another kind of camera.
        """
        if path.camera != "pinhole":
            raise ViewError(f"the learned policy needs a pinhole camera, the path is of a {path.camera}; use teach_repeat")
        self.settings = settings or LearnedSettings()
        self.model = model if isinstance(model, PathModel) else PathModel(model)
        self._hfov = path.hfov
        self._images = np.stack([self.model.fitted(node.view[0], path.hfov) for node in path.nodes])
        distances = np.array([node.distance for node in path.nodes])
        poses = node_poses(path)
        self._poses: F64 = self._seen_poses(distances) if poses is None else poses
        """(N, 3), of the nodes in the frame of the path."""
        turns, steps = np.diff(self._poses[:, 2]), np.diff(distances)
        self._turns: F64 = np.where(steps < _IN_PLACE, turns, 0.0)
        """(N - 1,): turns in place from node to node, radians to the left."""
        self._distances: F64 = np.concatenate([[0.0], np.cumsum(steps + _TURN_METRES * np.abs(self._turns))])
        """(N,): way along the path to each node, metres. Turns in place count, too: else all their nodes would be one place."""
        self._pivots = _pivots(self._turns, self._distances)
        """Begin and end of each turn in place that is made where it was recorded, metres along the path."""
        self._speeds = np.array([self._speed(part) for part in segments(path)])
        self._nodes = (nodes or NodeMatcher(path)) if self.settings.columns else None
        self._planner = ArcPlanner(self.settings.arcs)
        self._lattice = Lattice(self.settings.lattice)
        self._recovery = Recovery(self.settings.recovery)
        self.grid = OccupancyGrid(self._poses[:, :2], self.settings.occupancy)
        """What stands around the robot, in the frame of the path."""
        for pose, image in zip(self._poses, self._images, strict=True):
            recorded = self.model.estimate(image, image[None])
            self.grid.add_recorded(self._camera(pose), self.model.bearings, self.model.edges, recorded.hit)
        self.way: Way | None = None
        """Where the robot wants to drive; None = it has not looked yet."""
        self.filter = PoseFilter(self.model.offsets)
        """Where beside the path the robot is."""
        self.sighting: Sighting | None = None
        """What the network told about the last view."""
        self._track = ViewTrack(self.settings.camera_ahead)
        """Views of the last way."""
        self._last_ns: int | None = None
        """Stamp of the last view, ns."""
        self._unseen = self._disagreed = 0
        self._near = 0
        """Views in which something seemed near, less those since in which nothing did."""
        self._since_match: int | None = None
        """Views since the network saw a recorded image; None = it saw none yet."""
        self._alone = 0
        """Views in a row in which the localiser was lost."""
        self._pose: F64 = np.zeros(3)
        """x, y, yaw where the robot will be when it obeys, in the frame of the path."""
        self._here = 0.0
        """Distance along the path of the last view, metres."""
        self.reset()

    def reset(self) -> None:
        """Forgets all earlier views."""
        self._planner.reset()
        self._lattice.reset()
        self._recovery.reset()
        self.grid.clear()
        self._track.clear()
        self.sighting, self.way, self._last_ns = None, None, None
        self._unseen = self._disagreed = self._alone = self._near = 0
        self._since_match = None

    @property
    def is_sure(self) -> bool:
        """Whether the network saw lately where on the path the robot is."""
        since = self._since_match
        return since is not None and since <= self.settings.sure_views and self._alone < self.settings.lost_views

    def act(self, view: View, stamp_ns: int, place: Place) -> Velocity:
        """Returns the velocity towards a place of the path ahead, around what stands in the way."""
        settings = self.settings
        believed = float(np.interp(place.index, np.arange(len(self._distances)), self._distances))
        seconds = 0.0 if self._last_ns is None else (stamp_ns - self._last_ns) / NS_PER_S
        self._alone = self._alone + 1 if place.is_lost else 0
        if self._last_ns is None or seconds > _LONG_AGO:
            self._since_match = None
            if place.is_lost:
                return STOP  # nobody knows where the robot is
            self.filter.reset(self._at(believed))
            self._here = believed
            self._track.clear()
        else:
            self.filter.move(place.moved)
            self._track.move(place.moved)
        self._last_ns = stamp_ns
        here = self._along()
        self._disagreed = self._disagreed + 1 if not place.is_lost and abs(here - believed) > settings.far_off else 0
        if self._disagreed >= settings.far_off_views:
            self.filter.reset(self._at(believed))
            here = self._here = believed
            self._disagreed = 0
            self.grid.clear()
            self._lattice.reset()
        nodes = np.unique([int(np.abs(self._distances - here - ahead).argmin()) for ahead in settings.looked_for])
        image = self.model.fitted(view[0], self._hfov)
        self.sighting = sighting = self.model.estimate(image, self._images[nodes], self._track.earlier())
        self._track.add(image)
        seen = np.flatnonzero(sighting.match >= settings.least_match)
        level = self._at(here)
        fits = [
            self.filter.correct(self._poses[nodes[k]], self._in_base(sighting.pose[k]), sighting.scale[k], 1.0 / len(seen), level)
            for k in seen
        ]
        if any(fits):
            self._since_match = 0
        elif self._since_match is not None:
            self._since_match += 1
        if self._nodes is not None:
            fits.append(self._correct_by_columns(self._nodes, view, place, believed))
        self._unseen = 0 if any(fits) else self._unseen + 1
        self._look(sighting, seconds)
        return STOP if self._unseen > settings.unseen_views else self._drive(seconds, place.pending)

    def _correct_by_columns(self, nodes: NodeMatcher, view: View, place: Place, believed: float) -> bool:
        """Corrects the pose by the nodes next to the robot and by the localiser; returns whether one of the nodes was plausible."""
        if place.confidence >= self.settings.least_confidence and abs(believed - self._here) < self.settings.far_off:
            self.filter.correct_along(self._at(believed), _PLACE_DEVIATION)
        first = int(np.searchsorted(self._distances, self._along() - 0.05).clip(0, len(self._distances) - 1))
        end = min(first + 2, len(self._distances))
        matches = nodes.matcher.match(nodes.pattern(view), first, end)
        return any(
            score >= self.settings.least_score and self.filter.correct_heading(self._poses[first + k], float(turn))
            for k, (score, turn) in enumerate(zip(matches.scores, matches.turns, strict=True))
        )

    def _look(self, sighting: Sighting, seconds: float) -> None:
        """Puts into the map what is free and what is not."""
        self.grid.move_window(float(self.filter.pose[0]), float(self.filter.pose[1]))
        self.grid.decay(seconds)
        self.grid.integrate(self._camera(self.filter.pose), self.model.bearings, self.model.edges, sighting.hit)

    def _camera(self, pose: F64) -> F64:
        """Returns the pose (3,) of the camera of a robot at a pose (3,)."""
        x, y, yaw = pose
        return np.array(moved((x, y, yaw), self.settings.camera_ahead, 0.0))

    def _drive(self, seconds: float, pending: Step) -> Velocity:
        """Returns the velocity along the path, round what stands there.

        Args:
            seconds: time since the last view.
            pending: what the robot makes before it obeys.
        """
        settings = self.settings
        here = self._along()
        beyond, _, turned = relative(self._poses[-1], self.filter.pose)
        if here >= self._distances[-1] - 1e-6 and beyond > _OVERSHOOT and abs(turned) < math.pi / 2.0:
            return STOP
        x, y, yaw = (float(value) for value in self.filter.pose)
        self._pose = np.array(moved((x, y, yaw), pending.distance, pending.turn))
        here = min(here + max(0.0, pending.distance), float(self._distances[-1]))
        self.way = way = self._way(here)
        found = STOP
        if not self._recovery.is_backing and (way.is_free or way.free > settings.stop_before):
            found = self._planner.velocity(self._goal(way), self._clearance)
        if found == STOP:
            behind = self._clearance(np.array([[-0.1, 0.0], [-_BEHIND, 0.0]]))
            return self._recovery.blocked(here, seconds, can_back=bool((behind >= settings.lattice.room).all()))
        self._recovery.free(here)
        doubt, near = self._doubts(way)
        self._near = self._near + 1 if near >= settings.doubts[1] else max(0, self._near - 1)
        if near >= settings.doubts[1] and self._near <= settings.near_views:
            return STOP
        limit = self._limit(way, here, max(doubt, near))
        share = min(1.0, limit / max(abs(found.linear), 1e-6))
        return Velocity(share * found.linear, share * found.angular) if found.linear else found

    def _way(self, here: float) -> Way:
        lattice = self.settings.lattice
        count = math.ceil(min(lattice.length, self._distances[-1] - here + _OVERSHOOT) / lattice.step)
        along = here + np.arange(max(2, count + 1)) * lattice.step
        points, normals = self._beside(along)
        offset = float((self._pose[:2] - points[0]) @ normals[0])
        return self._lattice.way(along, points, normals, offset, self.grid.clearance)

    def _beside(self, along: F64) -> tuple[F64, F64]:
        """Returns points (K, 2) of the path, which goes on straight behind its end, and unit vectors (K, 2) to its left."""

        def points_at(at: F64) -> F64:
            points = np.stack([np.interp(at, self._distances, self._poses[:, k]) for k in range(2)], axis=1)
            end = self._poses[-1, 2]
            more = np.maximum(0.0, at - self._distances[-1])
            return np.asarray(points + more[:, None] * np.array([math.cos(end), math.sin(end)]))

        chord = points_at(along + _CHORD) - points_at(np.maximum(along - _CHORD, 0.0))
        chord /= np.maximum(np.linalg.norm(chord, axis=1, keepdims=True), 1e-6)
        return points_at(along), np.stack([-chord[:, 1], chord[:, 0]], axis=1)

    def _goal(self, way: Way) -> tuple[float, float, float]:
        """Returns the place that the robot goes for, in its own frame."""
        steps = np.linalg.norm(np.diff(way.points, axis=0), axis=1)
        driven = np.concatenate([[0.0], np.cumsum(steps)])
        ahead, here = self.settings.ahead, float(way.along[0])
        for start, end in self._pivots:
            if here < end - _AT_PIVOT and (reach := float(np.interp(start, way.along, driven))) < ahead:
                if here >= start - _AT_PIVOT:
                    yaw = float(self._at(min(end, max(here, start) + _TURN_METRES))[2])
                    return 0.0, 0.0, math.remainder(yaw - float(self._pose[2]), 2.0 * math.pi)
                x, y, yaw = (float(value) for value in self._at(start))
                more = ahead - reach
                return relative(self._pose, np.array([x + more * math.cos(yaw), y + more * math.sin(yaw), yaw]))
        at = np.array([np.interp(ahead, driven, values) for values in (way.points[:, 0], way.points[:, 1], way.along)])
        k = int(np.searchsorted(driven, ahead).clip(1, len(driven) - 1))
        slope = math.atan2(way.offsets[k] - way.offsets[k - 1], way.along[k] - way.along[k - 1])
        yaw = float(self._at(float(at[2]))[2])
        # The way goes on straight behind its end, so that the robot arrives there at its speed; the follower stops it.
        more = max(0.0, ahead - float(driven[-1]))
        goal = np.array([at[0] + more * math.cos(yaw), at[1] + more * math.sin(yaw), yaw + slope])
        return relative(self._pose, goal)

    def _limit(self, way: Way, here: float, doubt: float) -> float:
        """Returns the largest speed: the recorded one, or less where the way is narrow, blocked farther on, or not surely free."""
        settings, lattice = self.settings, self.settings.lattice
        middles = 0.5 * (self._distances[1:] + self._distances[:-1])
        limit = max(settings.least_linear, settings.speed_ratio * float(np.interp(here, middles, self._speeds)))
        near = way.clearance[way.along <= here + _SLOW_AHEAD].min()
        share = min(1.0, max(0.0, (float(near) - lattice.room) / lattice.comfort))
        low, high = settings.doubts
        sure = 1.0 - min(1.0, max(0.0, (doubt - low) / max(high - low, 1e-6)))
        limit = min(limit, settings.slow + min(share, sure) * max(0.0, settings.arcs.max_linear - settings.slow))
        if not way.is_free:
            limit = min(limit, max(settings.slow, (way.free - settings.stop_before) / settings.arcs.braking))
        return limit

    def _doubts(self, way: Way) -> tuple[float, float]:
        """Returns two probabilities, by the last view: that something stands on the way ahead, and that something is nearer than is believed.

        Each is that of the direction in which it is largest.
        """
        sighting, settings = self.sighting, self.settings
        assert sighting is not None
        x, y, yaw = self._camera(self.filter.pose)
        at = np.arange(0.1, settings.careful + 0.3, 0.05)
        angles = yaw + self.model.bearings
        rays = np.stack([x + at * np.cos(angles)[:, None], y + at * np.sin(angles)[:, None]], axis=-1)  # (D, R, 2)
        ahead = way.points[way.along <= way.along[0] + settings.careful]
        inside = np.linalg.norm(rays[:, :, None] - ahead, axis=3).min(axis=2) < settings.lattice.room
        crossing = np.flatnonzero(inside.any(axis=1))
        if not len(crossing):
            return 0.0, 0.0
        reach = at[inside.shape[1] - 1 - inside[crossing, ::-1].argmax(axis=1)]
        within, believed = self.grid.hit_cdf(self.model.edges, sighting.hit[crossing])
        found = [float(np.interp(r, self.model.edges, row)) for r, row in zip(reach, within, strict=True)]
        return float((believed * found).max()), float((1.0 - believed).max())

    def _clearance(self, points: F64) -> F64:
        """Returns (...,): distances from points (..., 2) in the frame of the robot to the nearest thing, metres."""
        x, y, yaw = self._pose
        c, s = math.cos(yaw), math.sin(yaw)
        ahead, left = points[..., 0], points[..., 1]
        return self.grid.clearance(np.stack([x + c * ahead - s * left, y + s * ahead + c * left], axis=-1))

    def _along(self) -> float:
        """Returns the distance along the path, metres, of its point that is nearest to the robot, and near where it was looked for."""
        points, (x, y) = self._poses[:, :2], self.filter.pose[:2]
        parts = np.diff(points, axis=0)
        lengths = np.maximum((parts**2).sum(axis=1), 1e-9)
        share = np.clip((([x, y] - points[:-1]) * parts).sum(axis=1) / lengths, 0.0, 1.0)
        away = np.linalg.norm(points[:-1] + share[:, None] * parts - [x, y], axis=1)
        # Of two parts of the path that are equally near, the robot is on the one along which it looks.
        turned = (self.filter.pose[2] - self._poses[:-1, 2] + math.pi) % (2.0 * math.pi) - math.pi
        in_place = self._turns != 0.0
        share = np.where(in_place, np.clip(turned / np.where(in_place, self._turns, 1.0), 0.0, 1.0), share)
        turned = np.abs(turned - share * self._turns)
        along = self._distances[:-1] + share * np.diff(self._distances)
        best = int((away + _TURN_METRES * turned + _JUMP * np.maximum(0.0, np.abs(along - self._here) - 1.0)).argmin())
        self._here = float(along[best])
        return self._here

    def _at(self, distance: float) -> F64:
        """Returns the pose (3,) at a distance along the path, metres, in its frame."""
        return np.array([np.interp(distance, self._distances, self._poses[:, k]) for k in range(3)])

    def _in_base(self, pose: F64) -> F64:
        """Returns (3,): the pose of the robot that recorded the camera, in the frame of this robot."""
        x, y, yaw = (float(value) for value in pose)
        ahead = self.settings.camera_ahead
        return np.array([ahead + x - ahead * math.cos(yaw), y - ahead * math.sin(yaw), yaw])

    def _seen_poses(self, distances: F64) -> F64:
        """Returns the poses of the nodes (N, 3) as the network sees one from the other, for a path without recorded velocities."""
        poses = [np.zeros(3)]
        for k in range(len(self._images) - 1):
            turn = float(self.model.estimate(self._images[k], self._images[k + 1 : k + 2]).pose[0, 2])
            x, y, yaw = (float(value) for value in poses[-1])
            poses.append(np.array(moved((x, y, yaw), float(distances[k + 1] - distances[k]), turn)))
        return np.array(poses)

    def _speed(self, part: Motion) -> float:
        return abs(part.distance) / part.duration if part.duration > 1e-3 else self.settings.usual_linear


def _pivots(turns: F64, distances: F64) -> tuple[tuple[float, float], ...]:
    """Returns begin and end along the path, metres, of each turn in place of ``_PIVOT`` or more.

    Args:
        turns: (N - 1,), made in place from node to node, radians.
        distances: (N,), of the nodes.
    """
    found, k = [], 0
    while k < len(turns):
        end = k
        while end < len(turns) and turns[end] != 0.0:
            end += 1
        if abs(turns[k:end].sum()) >= _PIVOT:
            found.append((float(distances[k]), float(distances[end])))
        k = end + 1
    return tuple(found)


def _is_fixed(shape: list[Any], dimensions: int) -> bool:
    return len(shape) == dimensions and all(isinstance(size, int) for size in shape)


def _is_image(shape: list[Any]) -> bool:
    return len(shape) == 4 and shape[0] == 1 and shape[3] == 3 and all(isinstance(size, int) for size in shape)
