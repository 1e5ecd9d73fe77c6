"""Tree of the newest tf transforms; a page needs no earlier ones. Pure."""

from __future__ import annotations

from typing import Any

import numpy as np

from gibson_sim.geometry.transforms import Mat4, invert, matrix_from_pose
from gibson_sim.types import Pose

_MAX_DEPTH = 100
"""Maximum number of frames from a leaf to the root; more indicates a cycle."""


class TransformTree:
    """The newest transform between each frame and its parent."""

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, Mat4]] = {}

    def set(self, parent: str, child: str, T_parent_child: Mat4) -> None:
        """Sets the newest transform of a frame, (4, 4)."""
        self._parents[child] = (parent, T_parent_child)

    def add(self, msg: Any) -> None:
        """Sets the transforms of a tf2_msgs/TFMessage."""
        for t in msg.transforms:
            p, q = t.transform.translation, t.transform.rotation
            matrix = matrix_from_pose(Pose((p.x, p.y, p.z), (q.x, q.y, q.z, q.w)))
            self.set(t.header.frame_id.lstrip("/"), t.child_frame_id.lstrip("/"), matrix)

    def to_root(self, frame: str) -> tuple[str, Mat4]:
        """Returns the root of the tree of a frame, and T_root_frame; an unknown frame is its own root."""
        matrix: Mat4 = np.eye(4)
        for _ in range(_MAX_DEPTH):
            if frame not in self._parents:
                break
            frame, step = self._parents[frame]
            matrix = step @ matrix
        return frame, matrix

    def between(self, target: str, frame: str) -> Mat4 | None:
        """Returns T_target_frame, (4, 4); None if tf does not connect the frames."""
        root, T_root_frame = self.to_root(frame)
        target_root, T_root_target = self.to_root(target)
        return invert(T_root_target) @ T_root_frame if root == target_root else None
