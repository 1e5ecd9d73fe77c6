"""Settings of the filler's pairs, training and evaluation."""

from __future__ import annotations

from dataclasses import dataclass, fields

from gibson_sim.errors import ConfigError
from gibson_sim.settings import check_settings, setting


@dataclass(frozen=True, slots=True)
class PairsSettings:
    """Settings of the scans and of the number of views."""

    seed: int = setting(0, "Random seed of scans and views", minimum=0, maximum=2**63 - 2)
    shards: int = setting(8, "Shards of 128 views for each training scene; other scenes have two", minimum=1, maximum=999)
    frames: int = setting(200, "Maximum number of images of a scan, at least 20", minimum=20, maximum=100_000)
    triangles: int = setting(150_000, "Triangles of the mesh of a scan", minimum=1000, maximum=10_000_000)

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True, slots=True)
class TrainingSettings:
    """Settings of the network's training."""

    seed: int = setting(0, "Random seed of the network and of the order of the examples", minimum=0, maximum=2**63 - 1)
    iterations: int = setting(60_000, "Optimiser steps", minimum=1, maximum=10_000_000)
    batch: int = setting(8, "Crops of views in a step", minimum=1, maximum=4096)
    crop: int = setting(128, "Edge of a crop, a multiple of 16", unit="px", minimum=32, maximum=256)
    learning_rate: float = setting(0.001, "Peak learning rate: a warm-up, then a cosine decay to 0", minimum=1e-6, maximum=1.0)
    weight_decay: float = setting(0.001, "Weight decay of AdamW", minimum=0.0, maximum=1.0)
    consistency: float = setting(
        8.0,
        "Weight of the consistency loss, which reduces flicker: difference between the images of a moved input and the moved images; 0 = none",
        minimum=0.0,
        maximum=100.0,
    )
    evaluate_every: int = setting(
        1000, "Iterations between two evaluations, and between two checkpoints", minimum=1, maximum=100_000
    )

    def __post_init__(self) -> None:
        check_settings(self)
        if self.crop % 16:
            raise ConfigError(f"setting 'crop' is {self.crop} px, must be a multiple of 16")


@dataclass(frozen=True, slots=True)
class EvaluationSettings:
    """Settings of the comparison of fillers."""

    seed: int = setting(0, "Random seed of drives and of the views of the contact sheet", minimum=0, maximum=2**63 - 1)
    every: int = setting(1, "Use every N-th view", minimum=1, maximum=128)
    drive: int = setting(60, "Images of a drive in each scene, for flicker, at least 2; 0 = none", minimum=0, maximum=280)

    def __post_init__(self) -> None:
        check_settings(self)
        if self.drive == 1:
            raise ConfigError("setting 'drive' is 1, must be 0 or 2 to 280: flicker is the difference of two images")


def options_of(settings: PairsSettings | TrainingSettings) -> str:
    """Returns the command-line options for the settings that differ from their defaults; each begins with a space."""
    values = {field.name: (getattr(settings, field.name), field.default) for field in fields(settings)}
    return "".join(f" --{name.replace('_', '-')} {value}" for name, (value, default) in values.items() if value != default)
