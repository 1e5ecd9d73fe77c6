"""The newest transforms of tf, as a tree: enough for a page, which shows the present. Pure."""

from __future__ import annotations

import numpy as np

from gibson_sim.geometry.transforms import Mat4, invert

_DEEPEST = 100
"""Frames from a leaf to the root; more is a cycle."""


class TransformTree:
    """Newest transform of each frame to its parent."""

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, Mat4]] = {}

    def set(self, parent: str, child: str, T_parent_child: Mat4) -> None:
        """Notes a transform, (4, 4)."""
        self._parents[child] = (parent, T_parent_child)

    def to_root(self, frame: str) -> tuple[str, Mat4]:
        """Returns the root above a frame, and T_root_frame; a frame that tf does not know is its own root."""
        matrix: Mat4 = np.eye(4)
        for _ in range(_DEEPEST):
            if frame not in self._parents:
                break
            frame, step = self._parents[frame]
            matrix = step @ matrix
        return frame, matrix

    def between(self, target: str, frame: str) -> Mat4 | None:
        """Returns T_target_frame, (4, 4); None where tf does not connect them."""
        root, T_root_frame = self.to_root(frame)
        other, T_root_target = self.to_root(target)
        return invert(T_root_target) @ T_root_frame if root == other else None
