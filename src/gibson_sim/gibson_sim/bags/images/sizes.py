"""Estimates the size of recorded images, as a basis for the choice of recording options. Pure."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from gibson_sim.durations import duration_text

ImageForm = Literal["raw", "compressed", "none"]
_PIXEL_BYTES = {
    "rgb": 3, "depth": 4, "semantic": 2, "instance": 2, "normal": 12, "normal_world": 12, "position": 12, "flow": 8,
    "hole": 1,
}  # fmt: skip
"""Output of a camera -> size of a raw pixel, bytes."""
_SMALLER = {"rgb": 14.0, "depth": 30.0, "semantic": 60.0, "instance": 60.0}
"""Output -> approximate compression ratio in furnished rooms; the other outputs are not compressed."""


@dataclass(frozen=True, slots=True)
class ImageStream:
    """The images of one output of a camera."""

    output: str
    width: int
    height: int
    rate_hz: float

    def bytes_per_s(self, form: ImageForm) -> float:
        """Returns the data rate, bytes per second of simulation time; an estimate for compressed images."""
        if form == "none":
            return 0.0
        raw = _PIXEL_BYTES.get(self.output, 4) * self.width * self.height * self.rate_hz
        return raw / _SMALLER.get(self.output, 1.0) if form == "compressed" else raw


def size_line(streams: Iterable[ImageStream], form: ImageForm, free_bytes: int, chunks: str = "none") -> str:
    """Returns a line with the data rate of the images of a recording, the time until the disk is full, and smaller alternatives.

    Args:
        streams: all recorded images, if each is rendered.
        form: form in which they are recorded.
        free_bytes: free space on the disk, bytes.
        chunks: compression of the bag's chunks, or ``none``.
    """
    streams = tuple(streams)
    now, compressed, raw = (sum(s.bytes_per_s(f) for s in streams) for f in (form, "compressed", "raw"))
    about = "up to" if form == "raw" else "about"
    stage = f" before --compression {chunks}" if chunks != "none" and form == "raw" else ""
    room_s = free_bytes / max(now, 1.0)
    room = "the disk has room for " + (duration_text(room_s) if room_s < 36_000.0 else "hours")
    other = (
        f"`--record-images compressed` takes about {_size(60.0 * compressed)}, `none` nothing"
        if form == "raw"
        else f"raw ones would be {_size(60.0 * raw)}"
    )
    return f"images are recorded {form}: {about} {_size(60.0 * now)} per minute{stage} ({room}); {other}"


def _size(count: float) -> str:
    return f"{count / 1e9:.1f} GB" if count >= 1e9 else f"{count / 1e6:.0f} MB"
