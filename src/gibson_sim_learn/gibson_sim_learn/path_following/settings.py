"""Configuration of a training: one YAML file, or the defaults of the class."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from gibson_sim.errors import ConfigError
from gibson_sim.formats.yaml_map import YamlMap, read_yaml_map
from gibson_sim.types import check_seed
from gibson_sim_learn.path_following.data import DataSettings

DEFAULT_CONFIG = Path(__file__).with_name("path_following.yaml")
"""The configuration of the command where no file is given."""


@dataclass(frozen=True, slots=True)
class DistanceSettings:
    """Training of the network of free distances, after the one of poses."""

    obstacle_shards: int = 30
    """Shards of images of obstacles of each training scene, see ``obstacles.py``; each validation scene has ``validation_shards``."""
    obstacle_share: float = 0.5
    """Share of these images in a step."""
    iterations: int = 14000
    """Steps of the optimiser."""
    images: int = 48
    """Images in a step."""
    learning_rate: float = 0.002
    """Largest step size; it rises at the start and falls to 0 along a cosine."""
    weight_decay: float = 0.02
    """Weight decay of AdamW."""

    def __post_init__(self) -> None:
        _check(
            self,
            ("obstacle_shards", 1, 1000),
            ("obstacle_share", 0.0, 1.0),
            ("iterations", 1, 10_000_000),
            ("images", 2, 4096),
            ("learning_rate", 1e-6, 1.0),
            ("weight_decay", 0.0, 1.0),
        )


@dataclass(frozen=True, slots=True)
class TrainingSettings:
    """Data and training of the networks."""

    seed: int = 0
    """Seed of the data, the network and the order of the examples."""
    shards: int = 40
    """Shards of each training scene."""
    validation_shards: int = 2
    """Shards of each validation scene."""
    iterations: int = 16000
    """Steps of the optimiser on the drawn data."""
    dagger_rounds: int = 2
    """Rounds of drives with the network, each followed by more iterations."""
    dagger_iterations: int = 4000
    """Steps of the optimiser after each round but the last."""
    last_iterations: int = 10000
    """Steps of the optimiser after the last round."""
    dagger_drives: int = 8
    """Drives in each training scene and round."""
    later: int = 24
    """Later images in a step."""
    recorded: int = 2
    """Recorded images for each later one; the same images also give pairs of different places."""
    learning_rate: float = 0.002
    """Largest step size; it rises at the start and falls to 0 along a cosine."""
    weight_decay: float = 0.01
    """Weight decay of AdamW."""
    evaluate_every: int = 250
    """Iterations between two points of the curve, and between two checkpoints."""
    bfloat16: bool = True
    """Compute in bfloat16 where the processor has instructions for it (AVX512-BF16); elsewhere it would be slower."""
    data: DataSettings = field(default_factory=DataSettings)
    """Amount and variety of the data."""
    distances: DistanceSettings = field(default_factory=DistanceSettings)
    """The network of free distances."""

    def __post_init__(self) -> None:
        check_seed("training", self.seed)
        _check(
            self,
            ("shards", 1, 1000),
            ("validation_shards", 1, 1000),
            ("iterations", 1, 10_000_000),
            ("dagger_rounds", 0, 100),
            ("dagger_iterations", 1, 10_000_000),
            ("last_iterations", 1, 10_000_000),
            ("dagger_drives", 1, 1000),
            ("later", 2, 4096),
            ("recorded", 1, 16),
            ("learning_rate", 1e-6, 1.0),
            ("weight_decay", 0.0, 1.0),
            ("evaluate_every", 1, 100_000),
        )


def _check(settings: object, *ranges: tuple[str, float, float]) -> None:
    for name, least, most in ranges:
        value = getattr(settings, name)
        if not least <= value <= most:
            raise ConfigError(f"{name} is {value:g}, must be {least:g} to {most:g}")


def load_settings(path: Path | None, seed: int | None = None) -> TrainingSettings:
    """Returns the settings of a file.

    Args:
        path: YAML file whose keys are the fields of ``TrainingSettings``, ``data`` and ``distances`` mappings with those of ``DataSettings``
            and ``DistanceSettings``; None = the configuration of the package.
        seed: takes the place of the file's; None = the file's.

    Raises:
        ConfigError: the file cannot be read, a key is unknown, or a value is not allowed.
    """
    names = tuple(f.name for f in fields(TrainingSettings))
    top = read_yaml_map(path or DEFAULT_CONFIG, names, ConfigError)
    default = TrainingSettings()
    parts: dict[str, type[DataSettings] | type[DistanceSettings]] = {"data": DataSettings, "distances": DistanceSettings}
    values = {name: _value(top, name, getattr(default, name)) for name in names if name not in parts}
    if seed is not None:
        values["seed"] = seed
    for key, kind in parts.items():
        if top.has(key):
            part = top.within(top.value(key), key, tuple(f.name for f in fields(kind)))
            values[key] = kind(**{f.name: _value(part, f.name, getattr(getattr(default, key), f.name)) for f in fields(kind)})
    return TrainingSettings(**values)


def as_dict(settings: TrainingSettings) -> dict[str, Any]:
    """Returns the settings as plain values, for JSON and for comparison."""
    return dataclasses.asdict(settings)


def _value(part: YamlMap, key: str, default: Any) -> Any:
    if isinstance(default, bool):
        return part.flag(key, default)
    if isinstance(default, tuple):
        return part.floats(key, len(default)) if part.has(key) else default
    value = part.number(key, float(default))
    if isinstance(default, int):
        if value != round(value):
            raise ConfigError(f"{part.where}: {key} is {value:g}, must be a whole number")
        return int(value)
    return value
