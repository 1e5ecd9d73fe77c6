"""Renders cameras at successive states and keeps each camera's previous state, for optical flow and motion blur."""

from __future__ import annotations

from collections.abc import Sequence

from gibson_sim.errors import GibsonSimError
from gibson_sim.geometry.exposures import needs_previous
from gibson_sim.render.readback.pixel_buffers import PendingFrames
from gibson_sim.render.renderer import Renderer
from gibson_sim.types import CameraSpec, SceneState


class FrameHistory:
    """Renders cameras at successive states, each with the motion since its own previous frame.

    Args:
        renderer: renderer, owned by the caller.
    """

    def __init__(self, renderer: Renderer) -> None:
        self._renderer = renderer
        self._previous: dict[str, SceneState] = {}

    def start(self, state: SceneState, cameras: Sequence[CameraSpec]) -> PendingFrames:
        """Starts rendering without waiting: start the next frames before calling ``result``, which returns them in the order of the cameras.

        For errors see ``Renderer.render``.
        """
        by_previous: dict[int, tuple[SceneState | None, list[int]]] = {}
        for number, camera in enumerate(cameras):
            previous = self._previous.get(camera.name) if needs_previous(camera) else None
            if previous is not None and previous.stamp_ns >= state.stamp_ns:
                previous = None  # time has jumped backwards, so there is no motion between the two
            by_previous.setdefault(id(previous), (previous, []))[1].append(number)
        parts: list[tuple[PendingFrames, Sequence[int]]] = []
        try:
            for previous, numbers in by_previous.values() or [(None, [])]:
                parts.append((self._renderer.start(state, [cameras[number] for number in numbers], previous), numbers))
        except GibsonSimError:
            for pending, _ in parts:
                pending.discard()
            raise
        self.note(state, cameras)
        return PendingFrames.joined(parts)

    def note(self, state: SceneState, cameras: Sequence[CameraSpec]) -> None:
        """Records a state, drawn or not, as the previous state of cameras: the motion in their next frames starts at it."""
        self._previous.update({camera.name: state for camera in cameras if needs_previous(camera)})

    def forget(self) -> None:
        """Forgets all previous states; call this after the scene has changed."""
        self._previous = {}
