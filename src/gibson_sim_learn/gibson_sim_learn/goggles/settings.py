"""Settings of the training of Goggles."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from gibson_sim.errors import ConfigError
from gibson_sim.types import check_seed


@dataclass(frozen=True, slots=True)
class GogglesSettings:
    """Settings of pairs, training and optimiser."""

    seed: int = 0
    """Random seed of the pairs, the initial weights and the sampling."""
    shards: int = 4
    """Shards of each training scene."""
    shots: int = 4
    """Augmentations of each view: random lighting and camera."""
    iterations: int = 3000
    """Optimiser steps."""
    batch: int = 16
    """Pairs per optimiser step."""
    learning_rate: float = 0.002
    """Learning rate after linear warm-up; it decays to 0 along a cosine."""
    weight_decay: float = 0.01
    """Weight decay of AdamW."""
    evaluate_every: int = 250
    """Iterations between two points of the curve, and between two checkpoints."""

    def __post_init__(self) -> None:
        check_seed("training", self.seed)
        for name, least, most in (
            ("shards", 1, 1000),
            ("shots", 1, 100),
            ("iterations", 1, 10_000_000),
            ("batch", 1, 4096),
            ("learning_rate", 1e-6, 1.0),
            ("weight_decay", 0.0, 1.0),
            ("evaluate_every", 1, 100_000),
        ):
            value = getattr(self, name)
            if not least <= value <= most:
                raise ConfigError(f"{name} is {value:g}, must be {least:g} to {most:g}")


def as_dict(settings: GogglesSettings) -> dict[str, Any]:
    """Returns the settings as plain values, for JSON and for the checkpoint."""
    return dataclasses.asdict(settings)
