"""Film strips and videos from a bag: images of several cameras, stacked vertically, over time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np

from gibson_sim.bags.images.decode import SUFFIXES as IMAGE_SUFFIXES, raw_image
from gibson_sim.bags.reader import COLOUR_ENCODINGS, BagReader, TopicInfo
from gibson_sim.bags.stamps import nominal_period_ns
from gibson_sim.bags.video import MAX_FPS, Bgr, Panels, image_topics, repeats_of
from gibson_sim.bags.video_file import write_frames
from gibson_sim.errors import RecordError
from gibson_sim.picture_files import SUFFIXES, write_picture
from gibson_sim.types import NS_PER_S

_GAP_PX = 4
"""White gap between the images of a strip, pixels."""
_VIEWS = "/view_"
"""Prefix of the topics of views."""


def film_topics(reader: BagReader, selection: Sequence[str] = ()) -> list[str]:
    """Returns image topics in the order in which they are shown, from the top.

    Args:
        reader: the bag.
        selection: topics, or names of cameras for their colour images; empty = all colour images, those of views last.

    Raises:
        RecordError: a topic does not exist.
    """
    infos = reader.topics()
    if selection:
        topics = [_topic_of(name, infos) for name in selection]
        unknown = [name for name, topic in zip(selection, topics, strict=True) if topic not in infos]
        if unknown:
            available = ", ".join(sorted(image_topics(reader))) or "none"
            raise RecordError(f"bag {reader.folder} has no images on {', '.join(unknown)}; it has them on: {available}")
        return topics
    colours = [name for name in sorted(image_topics(reader)) if raw_image(reader.first(name)).encoding in COLOUR_ENCODINGS]
    if not colours:
        raise RecordError(f"bag {reader.folder} has no colour images: record while the render node runs, or name topics")
    return sorted(colours, key=lambda name: (name.startswith(_VIEWS), name))


def _topic_of(name: str, infos: Mapping[str, TopicInfo]) -> str:
    """Returns the requested topic, or that of the colour images of a camera; the name of the raw topic if none exists."""
    raw = f"/{name.strip('/')}/image_raw"
    known = (name, *(name + suffix for suffix in IMAGE_SUFFIXES), raw, *(raw + suffix for suffix in IMAGE_SUFFIXES))
    return next((topic for topic in known if topic in infos), raw)


def write_film_strip(
    bag: str | Path,
    path: str | Path,
    *,
    topics: Sequence[str] = (),
    columns: int = 6,
    width: int = 320,
    begin: float = 0.0,
    end: float = 0.0,
) -> Path:
    """Writes a film strip: one row per topic, one column per time, evenly spaced from the first to the last, with the time below.

    Args:
        bag: folder of the bag.
        path: PNG or JPEG file to write; its folder is created if it does not exist.
        topics: as ``film_topics`` takes them.
        columns: number of times; fewer if the bag has fewer times at which every topic has an image.
        width: width of one image, pixels.
        begin: first time, seconds after the start of the bag.
        end: last time, seconds after the start of the bag; 0 = the end of the bag.

    Returns:
        The path.

    Raises:
        RecordError: the bag does not have the images.
        WriteError: the file cannot be written.
    """
    _check(columns, width)
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise RecordError(f"film strip {path}: the name must end in {', '.join(SUFFIXES)}")
    with BagReader(bag) as reader:
        panels = Panels(reader, film_topics(reader, topics))
        shown = _shown(reader, panels, begin, end)
        shown_indices = shown[np.unique(np.rint(np.linspace(0, len(shown) - 1, columns)).astype(np.int64))]
        cells = [
            np.vstack([_stacked(images, panels.topics, width, _GAP_PX), _time(width, int(panels.stamps[index]))])
            for index, images in panels.images(frozenset(shown_indices.tolist()))
        ]
    gap = np.full((cells[0].shape[0], _GAP_PX, 3), 255, dtype=np.uint8)
    strip = np.hstack([part for cell in cells for part in (cell, gap)][:-1])
    write_picture(path, strip)
    return path


def write_film(
    bag: str | Path,
    path: str | Path,
    *,
    topics: Sequence[str] = (),
    width: int = 640,
    begin: float = 0.0,
    end: float = 0.0,
    fps: float | None = None,
    speed: float = 1.0,
) -> Path:
    """Writes an H.264 video (MP4) of stacked topics, at the times at which all have an image, timed by their stamps.

    Args:
        bag: folder of the bag.
        path: file to write; its folder is created if it does not exist.
        topics: as ``film_topics`` takes them.
        width: width of the video, pixels.
        begin: first time, seconds after the start of the bag.
        end: last time, seconds after the start of the bag; 0 = the end of the bag.
        fps: frames per second; None = derived from the stamps, 60 at most.
        speed: seconds of simulation per second of video.

    Returns:
        The path.

    Raises:
        RecordError: the bag lacks the images.
        WriteError: the video cannot be written; no partial file remains.
    """
    _check(1, width)
    if not speed > 0.0 or (fps is not None and not fps > 0.0):
        raise RecordError(f"speed is {speed:g} and fps is {fps}; both must be above 0")
    with BagReader(bag) as reader:
        panels = Panels(reader, film_topics(reader, topics))
        shown = _shown(reader, panels, begin, end)
        stamps = panels.stamps[shown]
        rate = fps or min(NS_PER_S / (nominal_period_ns(stamps) or NS_PER_S / 10.0) * speed, MAX_FPS)
        repeats = dict(zip(shown.tolist(), repeats_of(stamps, NS_PER_S / rate * speed).tolist(), strict=True))
        frames = ((repeats[i], _stacked(images, panels.topics, width, 0)) for i, images in _needed(panels, repeats))
        write_frames(Path(path), rate, frames)
    return Path(path)


def _needed(panels: Panels, repeats: Mapping[int, int]) -> Iterator[tuple[int, dict[str, Bgr]]]:
    return panels.images(frozenset(index for index, count in repeats.items() if count))


def _check(columns: int, width: int) -> None:
    if not (1 <= columns <= 100 and 32 <= width <= 4096):
        raise RecordError(f"film of {columns} columns and width {width}; must be 1 to 100, and 32 to 4096 pixels")


def _shown(reader: BagReader, panels: Panels, begin: float, end: float) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Returns the indices of the frames between ``begin`` and ``end`` at which every topic has an image."""
    shown = panels.complete(begin, end)
    if not len(shown):
        span = f"between {begin:g} s and {f'{end:g} s' if end else 'the end'}"
        raise RecordError(
            f"bag {reader.folder}: {span} there is no moment at which all have an image: {', '.join(panels.topics)}"
        )
    return shown


def _stacked(images: Mapping[str, Bgr], topics: Sequence[str], width: int, gap: int) -> Bgr:
    """Returns the images stacked vertically, scaled to the same width with their aspect ratios."""
    parts = []
    for topic in topics:
        image = images[topic]
        height = max(round(image.shape[0] * width / image.shape[1]), 1)
        how = cv2.INTER_AREA if width < image.shape[1] else cv2.INTER_CUBIC
        parts.append(image if image.shape[1] == width else cv2.resize(image, (width, height), interpolation=how))
        parts.append(np.full((gap, width, 3), 255, dtype=np.uint8))
    return np.vstack(parts)


def _time(width: int, stamp_ns: int) -> Bgr:
    """Returns the caption of a column, black on white."""
    scale = max(width / 640.0, 0.4)
    line = np.full((round(40 * scale), width, 3), 255, dtype=np.uint8)
    text = f"{stamp_ns / NS_PER_S:.1f} s"
    (wide, _), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, scale, 1)
    at = ((width - wide) // 2, round(30 * scale))
    cv2.putText(line, text, at, cv2.FONT_HERSHEY_SIMPLEX, scale, (0, 0, 0), 1, cv2.LINE_AA)
    return line
