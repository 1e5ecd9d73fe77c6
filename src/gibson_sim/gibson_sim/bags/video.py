"""Writes a video and a contact sheet from the images of a bag: colour, with depth in false colours beside it."""

from __future__ import annotations

import bisect
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.bags.images.decode import IMAGE_TYPES, base_topic, raw_image
from gibson_sim.bags.reader import COLOUR_ENCODINGS, DEPTH_ENCODINGS, BagReader, image_to_array
from gibson_sim.bags.stamps import nominal_period_ns, stamp_ns
from gibson_sim.bags.video_file import write_frames
from gibson_sim.errors import RecordError
from gibson_sim.geometry.transforms import yaw_from_quat
from gibson_sim.picture_files import write_picture
from gibson_sim.quoting import quoted
from gibson_sim.sensors.false_colours import colourise_depth
from gibson_sim.types import NS_PER_S

ODOMETRY = "nav_msgs/msg/Odometry"
MOST_FRAMES = 5_000_000
"""Maximum number of frames of a video; about a day at 60 Hz."""
MAX_FPS = 60.0
"""Maximum of a frame rate that is derived from the stamps, Hz."""

Bgr = NDArray[np.uint8]


def image_to_bgr(msg: Any) -> Bgr:
    """Returns any supported ``sensor_msgs/Image`` or ``CompressedImage`` as a picture, (H, W, 3) uint8 BGR; depth in false colours.

    Raises:
        RecordError: the encoding is not supported.
    """
    msg = raw_image(msg)
    if msg.encoding not in (*COLOUR_ENCODINGS, *DEPTH_ENCODINGS):
        known = ", ".join((*COLOUR_ENCODINGS, *DEPTH_ENCODINGS))
        raise RecordError(f"image encoding {quoted(msg.encoding)} has no picture, must be one of {known}")
    pixels = image_to_array(msg)
    if msg.encoding == "rgb8":
        return np.ascontiguousarray(pixels[..., ::-1])
    if msg.encoding == "mono8":
        return np.repeat(pixels[..., None], 3, axis=2)
    if msg.encoding == "16UC1":
        return colourise_depth(pixels.astype(np.float32) / 1000.0)
    return colourise_depth(pixels) if msg.encoding == "32FC1" else np.ascontiguousarray(pixels)


def write_video(
    bag: str | Path,
    path: str | Path,
    *,
    topics: Sequence[str] | None = None,
    fps: float | None = None,
    speed: float = 1.0,
) -> Path:
    """Writes an H.264 video (MP4, plays in browsers and players) of a bag's images, timed by their stamps.

    Args:
        bag: folder of the bag.
        path: file to write; its folder is created if it does not exist.
        topics: image topics, shown side by side; the stamps of the first define the frames. None = the first colour camera and its depth.
        fps: frames per second of the video; None = derived from the stamps, 60 at most.
        speed: seconds of simulation per second of video.

    Returns:
        The path.

    Raises:
        RecordError: the bag has no images.
        WriteError: the video cannot be written; no partial file remains.
    """
    if not speed > 0.0 or (fps is not None and not fps > 0.0):
        raise RecordError(f"speed is {speed:g} and fps is {fps}; both must be above 0")
    path = Path(path)
    with BagReader(bag) as reader:
        panels = Panels(reader, topics)
        shown = panels.stamps
        period = nominal_period_ns(shown) or NS_PER_S / 10.0
        rate = fps or min(NS_PER_S / period * speed, MAX_FPS)
        repeats = repeats_of(shown, NS_PER_S / rate * speed)
        shown_pictures = panels.pictures(frozenset(np.flatnonzero(repeats).tolist()))
        write_frames(path, rate, ((int(repeats[index]), picture) for index, picture in shown_pictures))
    return path


def write_contact_sheet(
    bag: str | Path, path: str | Path, columns: int = 4, rows: int = 4, *, topics: Sequence[str] | None = None, width: int = 320
) -> Path:
    """Writes a PNG of images evenly spaced over the drive, each above its depth, with stamp and odometry below.

    Args:
        bag: folder of the bag.
        path: file to write; its folder is created if it does not exist.
        columns: images in a row.
        rows: rows of images; fewer if the bag has fewer images.
        topics: image topics, stacked vertically; None = the first colour camera and its depth.
        width: of one image on the sheet, pixels.

    Returns:
        The path.

    Raises:
        RecordError: the bag has no images.
        WriteError: the file cannot be written.
    """
    if columns < 1 or rows < 1 or width < 32:
        raise RecordError(f"contact sheet of {columns} columns, {rows} rows and width {width}; must be at least 1, 1 and 32")
    with BagReader(bag) as reader:
        panels = Panels(reader, topics)
        indices = np.unique(np.rint(np.linspace(0, len(panels.stamps) - 1, columns * rows)).astype(np.int64))
        odometry = _Odometry(reader)
        cells: list[Bgr] = []
        for index, picture in panels.pictures(frozenset(indices.tolist()), stacked=True):
            height = max(round(picture.shape[0] * width / picture.shape[1]), 1)
            small = cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)
            cell = np.vstack([small, _caption(width, int(panels.stamps[index]), odometry)])
            if cells and cell.shape != cells[0].shape:  # a camera may have changed its size during the recording
                cell = np.asarray(cv2.resize(cell, (width, cells[0].shape[0]), interpolation=cv2.INTER_AREA), dtype=np.uint8)
            cells.append(cell)
    blank = np.zeros_like(cells[0])
    columns = min(columns, len(cells))
    cells += [blank] * (-len(cells) % columns)
    sheet = np.vstack([np.hstack(cells[i : i + columns]) for i in range(0, len(cells), columns)])
    path = Path(path)
    write_picture(path, sheet)
    return path


class Panels:
    """The images of several topics, combined where their stamps are equal."""

    def __init__(self, reader: BagReader, topics: Sequence[str] | None) -> None:
        self._reader = reader
        self.topics = list(topics) if topics else _default_topics(reader)
        wrong = [t for t in self.topics if t in reader.topics() and reader.topics()[t].type_name not in IMAGE_TYPES]
        if wrong:
            raise RecordError(f"bag {reader.folder}: {', '.join(wrong)} holds no images ({' or '.join(IMAGE_TYPES)})")
        self._types = {topic: info.type_name for topic, info in reader.topics().items()}
        stamps: dict[str, list[int]] = {topic: [] for topic in self.topics}
        for topic, _, raw in reader.raw_messages(self.topics):
            stamps[topic].append(stamp_ns(raw))
        if not stamps[self.topics[0]]:
            raise RecordError(f"bag {reader.folder} has no images on {self.topics[0]}: record while the render node runs")
        self._stamps = {topic: set(values) for topic, values in stamps.items()}
        self._sizes: dict[str, tuple[int, ...]] = {}
        self.stamps: NDArray[np.int64] = np.unique(np.array(stamps[self.topics[0]], dtype=np.int64))
        """Stamps of the frames, increasing, nanoseconds."""

    def complete(self, begin: float = 0.0, end: float = 0.0) -> NDArray[np.int64]:
        """Returns the indices, increasing, of the frames at which every topic has an image.

        Args:
            begin: first time, seconds after the start of the bag.
            end: last time, seconds after the start of the bag; 0 = the end of the bag.
        """
        first_ns = self._reader.span_ns[0]
        late = first_ns + (round(end * NS_PER_S) if end else 2**62)
        alike = np.array([all(int(stamp) in stamps for stamps in self._stamps.values()) for stamp in self.stamps])
        return np.flatnonzero(alike & (self.stamps >= first_ns + round(begin * NS_PER_S)) & (self.stamps <= late))

    def pictures(self, indices: frozenset[int], stacked: bool = False) -> Iterator[tuple[int, Bgr]]:
        """Yields (index into ``stamps``, picture) of the requested frames, in order; black where a topic has no image."""
        for index, images in self.images(indices):
            yield index, self._join(images, stacked)

    def images(self, indices: frozenset[int]) -> Iterator[tuple[int, dict[str, Bgr]]]:
        """Yields (index into ``stamps``, images by topic) of the requested frames, in order."""
        todo = sorted(indices)
        numbers = {int(self.stamps[i]): i for i in todo}
        waiting: dict[int, dict[str, Bgr]] = {stamp: {} for stamp in numbers}
        for topic, _, raw in self._reader.raw_messages(self.topics):
            stamp = stamp_ns(raw)
            if stamp in waiting:
                waiting[stamp][topic] = image_to_bgr(self._reader.decode(self._types[topic], raw))
                self._sizes[topic] = waiting[stamp][topic].shape
            while todo and self._complete(stamp := int(self.stamps[todo[0]]), waiting[stamp]):
                yield todo.pop(0), waiting.pop(stamp)

    def _complete(self, stamp: int, images: dict[str, Bgr]) -> bool:
        return all(topic in images or stamp not in self._stamps[topic] for topic in self.topics)

    def _join(self, images: dict[str, Bgr], stacked: bool) -> Bgr:
        first = images[self.topics[0]]
        height, width = first.shape[:2]
        parts = []
        for topic in self.topics:
            part = images.get(topic)
            if part is None:
                part = np.zeros(self._sizes.get(topic, first.shape), dtype=np.uint8)
            if part.shape[:2] != (height, width):
                # Depth of another resolution: nearest neighbour, since interpolated false colours would be wrong depths.
                part = np.asarray(cv2.resize(part, (width, height), interpolation=cv2.INTER_NEAREST), dtype=np.uint8)
            parts.append(part)
        return np.vstack(parts) if stacked else np.hstack(parts)


def _default_topics(reader: BagReader) -> list[str]:
    """Returns the first colour topic and the depth topic of the same camera; either alone if there is only one."""
    infos = image_topics(reader)
    if not infos:
        raise RecordError(f"bag {reader.folder} has no images: record while the render node runs, with the image topics")
    encodings = {name: raw_image(reader.first(name)).encoding for name in infos}
    colour = [name for name, encoding in encodings.items() if encoding in COLOUR_ENCODINGS]
    depth = [name for name, encoding in encodings.items() if encoding in DEPTH_ENCODINGS]
    if not colour and not depth:
        raise RecordError(f"bag {reader.folder}: no image has a supported encoding, they are {encodings}")
    if not colour:
        return depth[:1]
    near = sorted((d for d in depth if _camera(d) == _camera(colour[0])), key=len)
    return [colour[0], *near[:1]]


def image_topics(reader: BagReader) -> list[str]:
    """Returns the image topics of a bag, sorted by name, each image once: raw if the bag has both raw and compressed images."""
    topics = [name for name, info in reader.topics().items() if info.type_name in IMAGE_TYPES and info.count]
    return [name for name in topics if base_topic(name) == name or base_topic(name) not in topics]


def _camera(topic: str) -> str:
    """Returns the namespace of the camera: ``/camera`` for ``/camera/image_raw`` and ``/camera/depth/image_raw``."""
    namespace = base_topic(topic).rpartition("/")[0]
    return namespace.rpartition("/")[0] if namespace.endswith(("/depth", "/rgb", "/color", "/colour")) else namespace


def repeats_of(stamps: NDArray[np.int64], step_ns: float) -> NDArray[np.int64]:
    """Returns the number of video frames of each image, (N,): every frame shows the image nearest in time.

    Raises:
        RecordError: the video would have more than ``MOST_FRAMES`` frames.
    """
    seconds = (stamps[-1] - stamps[0]) / NS_PER_S
    if (stamps[-1] - stamps[0]) / step_ns > MOST_FRAMES:
        raise RecordError(
            f"the stamps of the images span {seconds:.4g} s, a video of more than {MOST_FRAMES:,} frames: "
            "check them (gibson-sim bag check), choose a smaller --fps or a higher --speed"
        )
    count = int(np.floor((stamps[-1] - stamps[0]) / step_ns + 0.5)) + 1
    times = (np.arange(count) * step_ns).astype(np.float64)
    since_start = (stamps - stamps[0]).astype(np.float64)
    borders = (since_start[1:] + since_start[:-1]) / 2.0
    return np.bincount(np.searchsorted(borders, times, side="right"), minlength=len(stamps)).astype(np.int64)


class _Odometry:
    """The odometry of a bag, looked up by time; empty if the bag has none."""

    def __init__(self, reader: BagReader) -> None:
        names = sorted(
            (i.name for i in reader.topics().values() if i.type_name == ODOMETRY and i.count),
            key=lambda n: ("ground_truth" in n, n),
        )
        self._stamps: list[int] = []
        self._raw: list[bytes] = []
        self._reader = reader
        for _, _, raw in reader.raw_messages(names[:1]) if names else ():
            self._stamps.append(stamp_ns(raw))
            self._raw.append(raw)

    def text(self, stamp: int) -> str:
        """Returns the pose in the last odometry message up to the stamp, as text."""
        at = bisect.bisect_right(self._stamps, stamp) - 1
        if at < 0:
            return "no odometry"
        pose = self._reader.decode(ODOMETRY, self._raw[at]).pose.pose
        q = pose.orientation
        yaw = np.degrees(yaw_from_quat((q.x, q.y, q.z, q.w)))
        return f"x {pose.position.x:.2f} y {pose.position.y:.2f} m  {yaw:.0f} deg"


def _caption(width: int, stamp: int, odometry: _Odometry) -> Bgr:
    scale = width / 640.0
    line = round(36 * scale)
    caption = np.zeros((2 * line + 4, width, 3), dtype=np.uint8)
    for row, text in enumerate((f"{stamp / NS_PER_S:.3f} s", odometry.text(stamp))):
        at = (round(8 * scale), (row + 1) * line - round(8 * scale))
        cv2.putText(caption, text, at, cv2.FONT_HERSHEY_SIMPLEX, scale, (255, 255, 255), 1, cv2.LINE_AA)
    return caption


def write_pictures(bag: Path, video: Path) -> list[Path]:
    """Writes a video and, beside it, a contact sheet with the suffix ``.png``; returns both paths."""
    sheet = video.with_suffix(".png")
    write_video(bag, video)
    write_contact_sheet(bag, sheet)
    return [video, sheet]
