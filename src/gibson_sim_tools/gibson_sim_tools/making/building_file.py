"""Reads and writes plans of buildings as JSON, for a process with another Python interpreter. NumPy only."""

from __future__ import annotations

import dataclasses
import json
import typing
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gibson_sim.errors import SceneError
from gibson_sim.writing import write_file
from gibson_sim_tools.making.building import Building


@dataclass(frozen=True, slots=True)
class Quality:
    """Resolution and samples of a bake."""

    atlases: int
    """Number of atlases."""
    size_px: int
    """Edge of each atlas, pixels; a multiple of 2."""
    samples: int
    """Samples per pixel of the light pass."""
    jpeg: int = 85
    """JPEG quality, 1 to 100."""

    def __post_init__(self) -> None:
        if self.atlases < 1 or self.samples < 1 or self.size_px < 64 or self.size_px % 2 or not 1 <= self.jpeg <= 100:
            raise SceneError(
                f"quality is {self}; atlases and samples must be at least 1, size_px even and at least 64, jpeg 1 to 100"
            )


QUALITIES = {
    "smallest": Quality(1, 768, 1),
    "draft": Quality(2, 1024, 8),
    "normal": Quality(4, 2048, 6, 88),
    "high": Quality(4, 2048, 32, 90),
}


def write_plan(path: Path, building: Building, quality: Quality) -> None:
    """Writes a plan; equal plans give identical files."""
    values = {"building": dataclasses.asdict(building), "quality": dataclasses.asdict(quality)}
    write_file(path, json.dumps(values, sort_keys=True, separators=(",", ":")) + "\n")


def read_plan(path: Path) -> tuple[Building, Quality]:
    """Reads a plan that ``write_plan`` wrote.

    Raises:
        SceneError: the file is not a plan.
    """
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
        return _read(Building, values["building"]), _read(Quality, values["quality"])
    except (OSError, ValueError, KeyError, TypeError) as e:
        raise SceneError(f"{path}: is not the plan of a building: {e}; write it again") from e


def _read(annotation: Any, value: Any) -> Any:
    """Converts a JSON value to an annotated type."""
    if dataclasses.is_dataclass(annotation):
        hints = typing.get_type_hints(annotation)
        return annotation(**{f.name: _read(hints[f.name], value[f.name]) for f in dataclasses.fields(annotation)})  # type: ignore[operator]
    origin, args = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is tuple:
        items = args[:1] * len(value) if args[-1] is Ellipsis else args
        return tuple(_read(item, v) for item, v in zip(items, value, strict=True))
    if origin is Mapping:
        return {str(k): _read(args[1], v) for k, v in value.items()}
    return value if origin is typing.Literal else annotation(value)
