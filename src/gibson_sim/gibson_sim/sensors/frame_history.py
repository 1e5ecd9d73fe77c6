"""Takes pictures at one state after the other, and keeps what each camera needs of its picture before. Pure but for the renderer."""

from __future__ import annotations

from collections.abc import Sequence

from gibson_sim.geometry.exposures import needs_previous
from gibson_sim.render.readback.pixel_buffers import Pending
from gibson_sim.render.renderer import Renderer
from gibson_sim.types import CameraSpec, Frame, SceneState


class Taken:
    """Pictures that are drawn and on their way."""

    def __init__(self, parts: Sequence[tuple[Pending, Sequence[int]]]) -> None:
        self._parts = parts

    def frames(self) -> list[Frame]:
        """Returns the frames in the order of the cameras; waits until they are there."""
        found: dict[int, Frame] = {}
        for pending, numbers in self._parts:
            found.update(zip(numbers, pending.result(), strict=True))
        return [found[number] for number in sorted(found)]


class PictureTaker:
    """Draws cameras at states, each with the motion since its own picture before.

    Args:
        renderer: draws; stays the caller's.
    """

    def __init__(self, renderer: Renderer) -> None:
        self._renderer = renderer
        self._previous: dict[str, SceneState] = {}

    def take(self, state: SceneState, cameras: Sequence[CameraSpec]) -> Taken:
        """Draws and returns at once: ask for the next pictures before taking the frames of these. For errors see ``Renderer.render``."""
        since: dict[int, tuple[SceneState | None, list[int]]] = {}
        for number, camera in enumerate(cameras):
            previous = self._previous.get(camera.name) if needs_previous(camera) else None
            if previous is not None and previous.stamp_ns >= state.stamp_ns:
                previous = None  # time went back: what lies between the two is no motion
            since.setdefault(id(previous), (previous, []))[1].append(number)
        parts = [
            (self._renderer.start(state, [cameras[number] for number in alike], previous), alike)
            for previous, alike in since.values()
        ]
        self.note(state, cameras)
        return Taken(parts)

    def note(self, state: SceneState, cameras: Sequence[CameraSpec]) -> None:
        """Takes that cameras had a picture at a state, drawn or not: the motion in their next ones counts from here."""
        self._previous.update({camera.name: state for camera in cameras if needs_previous(camera)})

    def forget(self) -> None:
        """Takes the next pictures as the first ones: the scene has changed."""
        self._previous = {}
