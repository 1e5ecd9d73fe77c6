"""What all trainings share: the step size, checkpoints that fit the settings, a curve as a picture. Needs PyTorch."""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from gibson_sim.errors import ConfigError
from gibson_sim.writing import replacing, write_file

COLUMNS = 4
"""Most panels of a curve beside each other."""


def has_bfloat16() -> bool:
    """Returns whether the processor computes in bfloat16 by itself, as far as Linux tells."""
    try:
        return "avx512_bf16" in Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return False


def step_size(largest: float, done: int, total: int, warm_up: int) -> float:
    """Returns the step size of an iteration: it rises for some iterations, and falls as a cosine to 0 at the last.

    Args:
        largest: step size after the rise.
        done: iterations before this one.
        total: iterations in all.
        warm_up: iterations in which it rises.
    """
    return largest * min(1.0, (done + 1) / warm_up) * 0.5 * (1.0 + math.cos(math.pi * done / max(1, total)))


def set_step_size(optimiser: torch.optim.Optimizer, rate: float) -> None:
    """Sets the step size of all weights."""
    for group in optimiser.param_groups:
        group["lr"] = rate


def descend(network: nn.Module, optimiser: torch.optim.Optimizer, loss: Tensor, longest: float) -> float:
    """Makes one step of an optimiser, and returns the loss.

    Args:
        network: whose gradients are shortened together, to a norm of ``longest``.
        optimiser: of its weights.
        loss: scalar.
        longest: largest norm of the gradients.
    """
    optimiser.zero_grad(set_to_none=True)
    loss.backward()
    nn.utils.clip_grad_norm_(network.parameters(), longest)
    optimiser.step()
    return float(loss.detach())


def save_checkpoint(file: Path, content: Mapping[str, Any]) -> None:
    """Writes a checkpoint, whole or not at all.

    Args:
        file: in the folder of the training, which is made.
        content: with the settings under ``settings``.
    """
    file.parent.mkdir(parents=True, exist_ok=True)
    with replacing(file) as draft:
        torch.save(dict(content), draft)


def load_checkpoint(file: Path, settings: Mapping[str, Any], may_change: Collection[str]) -> dict[str, Any]:
    """Returns the content of a checkpoint of a training with these settings.

    Args:
        file: in the folder of the training.
        settings: of the training that goes on.
        may_change: names of those by which a training can be made longer.

    Raises:
        ConfigError: it cannot be read, or is of other settings.
    """
    try:
        content: dict[str, Any] = torch.load(file, weights_only=False)
        there = content["settings"]
    except Exception as error:
        raise ConfigError(f"{file}: cannot be read: {error}; delete it to begin again") from error
    other = [name for name in settings if there.get(name) != settings[name] and name not in may_change]
    if other:
        raise ConfigError(
            f"{file.parent}: holds a training with another {other[0]} ({there.get(other[0])}); choose another --folder"
        )
    return content


def write_curve(folder: Path, curve: Sequence[Any], panels: Sequence[tuple[str, Sequence[str]]], columns: int = COLUMNS) -> None:
    """Writes ``curve.json`` and, with Matplotlib, ``curve.png``.

    Args:
        folder: of the training.
        curve: dataclasses, points with ``iteration`` and the fields of the panels.
        panels: title and fields of each.
        columns: panels beside each other.
    """
    write_file(folder / "curve.json", json.dumps([asdict(point) for point in curve], indent=1) + "\n")
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        return
    columns = min(columns, len(panels))
    rows = math.ceil(len(panels) / columns)
    figure = Figure(figsize=(3.0 * columns, 3.0 if rows == 1 else 2.5 * rows), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    for axis, (title, names) in zip(figure.subplots(rows, columns).flat, panels, strict=True):
        for name in names:
            values = [getattr(point, name) for point in curve]
            axis.plot([point.iteration for point in curve], values, label=name)
        axis.set_title(title, fontsize=9)
        axis.set_xlabel("iteration", fontsize=8)
        axis.grid(alpha=0.3)
        if len(names) > 1:
            axis.legend(fontsize=8)
    with replacing(folder / "curve.png") as draft:
        figure.savefig(draft, format="png")
