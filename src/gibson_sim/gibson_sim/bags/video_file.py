"""Writes H.264 videos (MP4) atomically."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import RecordError
from gibson_sim.writing import cannot_write, replacing

H264 = {"preset": "veryfast", "crf": "20"}
"""Options of libx264: about 100 frames of 1280x480 a second on two cores, with hardly a visible loss."""


def write_frames(
    path: Path,
    fps: float,
    frames: Iterable[tuple[int, NDArray[np.uint8]]],
    *,
    options: Mapping[str, str] = H264,
    channels: str = "bgr24",
) -> None:
    """Writes a video that browsers and players support; writes no file without frames.

    Args:
        path: file to write; its folder is created if it does not exist.
        fps: frames per second.
        frames: pairs of the number of repetitions and the image, (H, W, 3); all images have the same size.
        options: options of the encoder libx264.
        channels: order of the channels, as PyAV names it.

    Raises:
        RecordError: an image differs in size from the first one.
        WriteError: the file cannot be written; no partial file remains.
    """
    with ExitStack() as stack:
        video: _Video | None = None
        for count, picture in frames:
            if video is None:
                draft = stack.enter_context(replacing(path))
                video = stack.enter_context(_Video(path, draft, fps, (picture.shape[1], picture.shape[0]), options, channels))
            for _ in range(count):
                video.write(picture)
        if video is not None:
            video.finish()


class _Video:
    """A video that is being written."""

    def __init__(
        self, path: Path, draft: Path, fps: float, size: tuple[int, int], options: Mapping[str, str], channels: str
    ) -> None:
        """Opens the file. ``size`` is (width, height), pixels."""
        # H.264 in 4:2:0 requires an even width and height.
        self._size = (size[0] + size[0] % 2, size[1] + size[1] % 2)
        self._path, self._channels, self._frames = path, channels, 0
        self._file = _Output(draft)
        self._container: Any = av.open(self._file, "w", format="mp4", options={"movflags": "faststart"})
        rate = Fraction(fps).limit_denominator(1000)
        self._stream: Any = self._container.add_stream("libx264", rate=rate, options=dict(options))
        self._stream.width, self._stream.height = self._size
        self._stream.pix_fmt = "yuv420p"

    def write(self, picture: NDArray[np.uint8]) -> None:
        """Appends a frame; all images must have the size of the first one."""
        right, bottom = self._size[0] - picture.shape[1], self._size[1] - picture.shape[0]
        if not (0 <= right <= 1 and 0 <= bottom <= 1):
            raise RecordError(
                f"an image changes its size to {picture.shape[1]}x{picture.shape[0]} in the bag: no video can be made"
            )
        if right or bottom:
            picture = np.asarray(cv2.copyMakeBorder(picture, 0, bottom, 0, right, cv2.BORDER_REPLICATE), dtype=np.uint8)
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format=self._channels)
        frame.pts = self._frames
        self._frames += 1
        self._container.mux(self._stream.encode(frame))
        self._check()

    def finish(self) -> None:
        """Flushes the encoder and closes the file."""
        self._container.mux(self._stream.encode(None))
        self._close()
        self._check()

    def _close(self) -> None:
        container, self._container = self._container, None
        if container is None:
            return
        try:
            container.close()
        except OSError:
            # FFmpeg reads the frames again to move the index to the front; frames that could not be written are missing.
            if self._file.error is None:
                raise

    def _check(self) -> None:
        if self._file.error is not None:
            raise cannot_write(self._path, self._file.error, self._file.size, self._file.kept)

    def __enter__(self) -> _Video:
        return self

    def __exit__(self, *_: object) -> None:
        try:
            self._close()
        finally:
            self._file.close_file()


class _Output:
    """Output file of the encoder. Writes never fail, since FFmpeg aborts the process if it cannot write the header of a file."""

    def __init__(self, path: Path) -> None:
        self.name = str(path)
        """Path that FFmpeg opens to read the file again."""
        self.error: OSError | None = None
        """First error of a write; later writes are dropped."""
        self.size = 0
        """Size of the file including dropped writes, bytes."""
        self.kept = 0
        """Number of bytes written."""
        self._position = 0
        self._descriptor = os.open(path, os.O_WRONLY | os.O_CLOEXEC)

    def write(self, data: Any) -> int:
        """Writes, or stores the error."""
        view = memoryview(data).cast("B")
        length, at = len(view), self._position
        try:
            while view and self.error is None:
                written = os.pwrite(self._descriptor, view, at)
                view, at = view[written:], at + written
                self.kept = max(self.kept, at)
        except OSError as error:
            self.error = error
        self._position += length
        self.size = max(self.size, self._position)
        return length

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Sets the position; returns it."""
        self._position = offset + {os.SEEK_SET: 0, os.SEEK_CUR: self._position}.get(whence, self.size)
        return self._position

    def tell(self) -> int:
        """Returns the position."""
        return self._position

    def close_file(self) -> None:
        """Closes the file; PyAV must not, since it would close it twice."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1
