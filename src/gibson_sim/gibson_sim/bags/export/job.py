"""Options, state and report of an export."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, get_args

from gibson_sim.bags.export.poses import Poses, PoseSource
from gibson_sim.bags.export.read import CameraImage, ExportCamera, camera_images, find_cameras, nearest
from gibson_sim.bags.progress import Advance
from gibson_sim.bags.reader import BagReader
from gibson_sim.errors import ConfigError, RecordError
from gibson_sim.quoting import quoted
from gibson_sim.types import NS_PER_S

Format = Literal["tum", "nerfstudio", "lerobot", "png"]
FORMATS: tuple[Format, ...] = get_args(Format)


@dataclass(frozen=True, slots=True)
class ExportOptions:
    """Selection and formats of an export."""

    topics: tuple[str, ...] = ()
    """Image topics; empty = all."""
    begin: float = 0.0
    """First time to export, seconds after the start of the bag."""
    end: float = 0.0
    """Last time to export, seconds after the start of the bag; 0 = the end of the bag."""
    every: int = 1
    """Export every n-th image of each camera."""
    image: str = "png"
    """Format of colour images: png or jpg."""
    depth: str = "png"
    """Format of depth images: png (16 bits) or npy (float32, exact)."""
    poses: str = "auto"
    """Source of the poses: auto, scene or tf."""
    fixed_frame: str = ""
    """Frame of the poses from tf; empty = map, odom or world."""
    max_difference: float = 0.02
    """Maximum difference of the stamps of matched images, seconds."""
    fps: int = 0
    """LeRobot: frames per second; 0 = the rate of the images."""
    task: str = "drive"
    """LeRobot: description of the task."""

    def __post_init__(self) -> None:
        for name, value, known in (
            ("image", self.image, ("png", "jpg")), ("depth", self.depth, ("png", "npy")),
            ("poses", self.poses, ("auto", "scene", "tf")),
        ):  # fmt: skip
            if value not in known:
                raise ConfigError(f"{name} is {quoted(value)}, must be one of {', '.join(known)}")
        if (
            self.every < 1
            or self.fps < 0
            or self.max_difference < 0
            or self.begin < 0
            or 0 < self.end <= self.begin
            or self.end < 0
        ):
            raise ConfigError(
                f"every is {self.every}, fps {self.fps}, max_difference {self.max_difference:g} s, begin {self.begin:g} s, end "
                f"{self.end:g} s: must be 1 or more, 0 or more, 0 or more, 0 or more, and after begin (or 0)"
            )


@dataclass(slots=True)
class ExportReport:
    """Files written, and notes on what the bag lacks."""

    lines: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


class ExportJob:
    """One export of a bag.

    Args:
        bag: the bag.
        output: folder; must not exist, or be empty.
        options: selection and formats.
        advance: receives the progress.

    Raises:
        RecordError: there is nothing to export, or the folder is not empty.
    """

    def __init__(self, bag: BagReader, output: Path, options: ExportOptions, advance: Advance) -> None:
        self.bag, self.output, self.options, self.advance = bag, output, options, advance
        self.report = ExportReport()
        if output.exists() and (not output.is_dir() or any(output.iterdir())):
            raise RecordError(f"{output} already exists and is not an empty folder: choose another name or remove it")
        begin, end = bag.span_ns
        self.begin_ns: int = begin + round(options.begin * NS_PER_S)
        self.end_ns: int = min(end, begin + round(options.end * NS_PER_S)) if options.end else end
        self.cameras, notes = find_cameras(bag, options.topics, self.begin_ns, self.end_ns + 1)
        if not self.cameras:
            raise RecordError(
                f"bag {bag.folder} has no image after {options.begin:g} s; it is {(end - begin) / NS_PER_S:g} s long"
            )
        self.report.notes += notes
        self._poses = Poses(bag, options.poses, options.fixed_frame)

    def wanted(self, camera: ExportCamera, output: str = "") -> set[int]:
        """Returns the stamps of a camera's images to export: every n-th of its first output, and the nearest ones of other outputs."""
        first = camera.stamps[camera.first][:: self.options.every].tolist()
        if output in ("", camera.first):
            return set(first)
        if self.options.every == 1:
            return set(camera.stamps[output].tolist())
        matching = (nearest(camera.stamps[output], stamp, self.most_ns) for stamp in first)
        return {stamp for stamp in matching if stamp is not None}

    @property
    def most_ns(self) -> int:
        """Maximum difference of the stamps of images of one moment, nanoseconds."""
        return round(self.options.max_difference * NS_PER_S)

    def pose_source(self, camera: ExportCamera) -> PoseSource | None:
        """Returns the source of the camera's poses; adds a note if there is none."""
        source = self._poses.of(camera)
        if source is None:
            reason = "no transforms of /tf and /tf_static connect its frame to "
            self.report.notes.append(
                f"camera {camera.name} (frame {quoted(camera.frame_id)}) has no poses: {reason}"
                f"{self.options.fixed_frame or 'another frame'}, and no /scene contains it"
            )
        return source

    def images(self, cameras: Sequence[ExportCamera]) -> Iterator[CameraImage]:
        """Yields the images of cameras to export, in the order of the bag, and reports progress."""
        selected = {(camera.name, output): self.wanted(camera, output) for camera in cameras for output in camera.streams}
        total, done = sum(len(stamps) for stamps in selected.values()), 0
        for picture in camera_images(self.bag, cameras, self.begin_ns, self.end_ns + 1):
            if picture.stamp_ns in selected[picture.camera.name, picture.output]:
                done += 1
                self.advance(done / total)
                yield picture
