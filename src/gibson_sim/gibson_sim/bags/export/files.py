"""Writes image files in background threads, and tables."""

from __future__ import annotations

import csv
import os
from collections.abc import Iterable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from types import TracebackType
from typing import Any

import cv2
from numpy.typing import NDArray

from gibson_sim.bags.export.read import CameraImage, depth_in_units
from gibson_sim.picture_files import write_array, write_picture
from gibson_sim.writing import replacing, write_file

JPEG_QUALITY = 95
PNG_LEVEL = 2
"""Compression level: a third of the time of OpenCV's default, files a few percent larger."""
MM_PER_METRE = 1000.0
_NS_DIGITS = 9


def seconds(stamp_ns: int) -> str:
    """Returns a stamp in seconds with all nine decimals."""
    whole, rest = divmod(stamp_ns, 10**_NS_DIGITS)
    return f"{whole}.{rest:0{_NS_DIGITS}d}"


def image_suffix(picture: CameraImage, image: str, depth: str) -> str:
    """Returns the suffix of the file of an image.

    Args:
        picture: the image.
        image: format of colour images, ``png`` or ``jpg``; compressed images keep their format.
        depth: format of depth images, ``png`` or ``npy``.
    """
    kind = picture.stream.kind
    if kind == "color":
        return picture.stream.encoding if picture.encoded() is not None else image
    return {"depth": depth, "labels": "png"}.get(kind, "npy")


class ImageFiles:
    """Writes images in background threads. To be used as a context manager.

    Args:
        depth_per_metre: units per metre of a 16-bit depth PNG.
    """

    def __init__(self, depth_per_metre: float = MM_PER_METRE) -> None:
        self._scale = depth_per_metre
        threads = os.cpu_count() or 1
        self._pool = ThreadPoolExecutor(threads, thread_name_prefix="images")
        self._waiting: list[Future[None]] = []
        self._most = 4 * threads
        self.count = 0

    def write(self, path: Path, picture: CameraImage) -> None:
        """Queues an image; blocks while too many are queued.

        Raises:
            WriteError: an earlier file could not be written.
        """
        while len(self._waiting) >= self._most:
            self._waiting.pop(0).result()
        self.count += 1
        self._waiting.append(self._pool.submit(self._write, path, picture))

    def _write(self, path: Path, picture: CameraImage) -> None:
        encoded = picture.encoded()
        if encoded is not None:
            write_file(path, encoded, durable=False)
        elif path.suffix == ".npy":
            write_array(path, picture.metres() if picture.stream.kind == "depth" else picture.array(), durable=False)
        else:
            write_picture(path, self._pixels(picture), _options(path.suffix), durable=False)

    def _pixels(self, picture: CameraImage) -> NDArray[Any]:
        if picture.stream.kind == "color":
            return picture.bgr()
        return depth_in_units(picture.metres(), self._scale) if picture.stream.kind == "depth" else picture.array()

    def __enter__(self) -> ImageFiles:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        try:
            if kind is None:
                for future in self._waiting:
                    future.result()
        finally:
            self._pool.shutdown(wait=True, cancel_futures=True)


def _options(suffix: str) -> Sequence[int]:
    return (cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY) if suffix == ".jpg" else (cv2.IMWRITE_PNG_COMPRESSION, PNG_LEVEL)


def write_table(path: Path, header: Sequence[str], rows: Iterable[Sequence[Any]]) -> int:
    """Writes a CSV file; returns the number of rows."""
    count = 0
    with replacing(path) as draft, draft.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(header)
        for row in rows:
            writer.writerow(row)
            count += 1
    return count


def write_lines(path: Path, lines: Iterable[str]) -> None:
    """Writes a text file."""
    write_file(path, "".join(f"{line}\n" for line in lines))
