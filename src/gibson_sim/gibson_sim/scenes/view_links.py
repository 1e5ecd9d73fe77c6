"""Views in the states of a scene: each is a link of its own, so that whoever draws a state finds its camera there."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from gibson_sim.errors import ConfigError
from gibson_sim.quoting import quoted
from gibson_sim.scenes.spec import DrawnScene
from gibson_sim.scenes.views import ROBOT, FloorOf, Path, View
from gibson_sim.types import CameraSpec, Pose, SceneState


class Views:
    """The views of one revision of a scene. Those whose target is not there are left out.

    Args:
        views: what was asked for.
        scene: what there is, without the views.
        robot: name of the first robot; empty = there is none.
        floor: says how far the floor reaches; asked only where a view shows all of it.

    Raises:
        GibsonSimError: a view cannot show what it should, or the floor is not known.
    """

    def __init__(self, views: Iterable[View], scene: DrawnScene, robot: str, floor: FloorOf) -> None:
        self._scene = scene
        self._names = {camera.name for camera in scene.cameras}
        self._paths: list[Path] = []
        self._rows: list[int] = []
        cameras: list[CameraSpec] = []
        self.absent: dict[str, str] = {}
        """Why others are not there, by the names of their cameras, one line each."""
        for view in views:
            try:
                row = self._row(view, robot)
            except ConfigError as error:
                self.absent[view.camera.name] = str(error)
                continue
            path, near = view.motion.settled(view.camera, floor)
            camera = view.camera if view.own_near else replace(view.camera, near=near, far=max(view.camera.far, near + 20.0))
            cameras.append(camera)
            self._names.add(camera.name)
            self._paths.append(path)
            self._rows.append(row)
        self.cameras = tuple(cameras)
        """Of the views that are there."""

    @property
    def scene(self) -> DrawnScene:
        """The scene with the views: their links and cameras come last."""
        own = tuple(camera.link for camera in self.cameras)
        return replace(self._scene, links=(*self._scene.links, *own), cameras=(*self._scene.cameras, *self.cameras))

    def poses(self, state: SceneState) -> list[Pose]:
        """Returns T_world_optical of each camera at a state of the scene."""
        found = []
        for path, row in zip(self._paths, self._rows, strict=True):
            target = Pose()
            if row >= 0:
                x, y, z = state.positions[row].tolist()
                qx, qy, qz, qw = state.quats_xyzw[row].tolist()
                target = Pose((x, y, z), (qx, qy, qz, qw))
            found.append(path.camera_pose(target, state.stamp_ns))
        return found

    def extended(self, state: SceneState, poses: Sequence[Pose] | None = None) -> SceneState:
        """Returns the state of ``scene``; ``poses``: those at the state, where they are known. Views have no velocities."""
        if not self.cameras:
            return state
        if poses is None:
            poses = self.poses(state)
        return replace(
            state,
            links=(*state.links, *(camera.link for camera in self.cameras)),
            positions=np.concatenate([state.positions, [pose.position for pose in poses]]),
            quats_xyzw=np.concatenate([state.quats_xyzw, [pose.quat_xyzw for pose in poses]]),
            twists=np.concatenate([state.twists, np.zeros((len(poses), 6))]),
        )

    def _row(self, view: View, robot: str) -> int:
        """Returns the row of a view's target in a state; -1 = it has none."""
        name, target, links = view.camera.name, view.motion.target, self._scene.links
        if name in self._names or view.camera.link in links:
            raise ConfigError(
                f"view {quoted(name)}: the scene has a camera of this name already; give the view another one, in a file"
            )
        if not target:
            return -1
        if target in links:
            return links.index(target)
        body = robot if target == ROBOT else target
        bodies = list(dict.fromkeys(link.partition("/")[0] for link in links if "/" in link))
        if body not in bodies:
            what = "there is no robot" if target == ROBOT else f"nothing is called {quoted(target)}"
            known = ", ".join(bodies[:20]) + (", ..." if len(bodies) > 20 else "")
            raise ConfigError(f"view {quoted(name)}: {what}; it can go with: {known or 'nothing'}")
        # The links of a body stand together, the root first.
        return next(row for row, link in enumerate(links) if link.startswith(f"{body}/"))
