"""What all trainings share: the loop, the step size, checkpoints from which a training goes on, its curve. Needs PyTorch.

A training has a folder. An interrupted one goes on from its last checkpoint; with the same settings, seed, data and software on the same
kind of processor it gives what an uninterrupted one gives, up to the rounding of sums.
"""

from __future__ import annotations

import json
import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar

import numpy as np
import torch
from torch import Tensor, nn

from gibson_sim.errors import ConfigError
from gibson_sim.writing import replacing, write_file

Progress = Callable[[str], None]
"""Called with one line now and then."""
Panels = Sequence[tuple[str, Sequence[str]]]
"""Of the picture of a curve: the title of each, and the fields of a point that it shows."""


@dataclass(frozen=True, slots=True)
class CurvePoint:
    """Errors on the validation scenes after some iterations."""

    iteration: int
    loss: float
    """Mean loss of training since the point before."""
    processor_s: float
    """Processor time of the training so far, seconds."""


@dataclass(frozen=True, slots=True)
class Descent:
    """How the optimiser, AdamW, goes down."""

    seed: int
    """Of weights, order of the examples and changes to them."""
    learning_rate: float
    """Largest step size."""
    weight_decay: float
    warm_up: int
    """Iterations in which the step size rises."""
    longest: float
    """Largest norm of the gradients of all weights together; longer ones are shortened."""
    evaluate_every: int
    """Iterations between two points of the curve, which are also checkpoints."""
    bfloat16: bool = True
    """Compute in bfloat16 where the processor can."""


P = TypeVar("P", bound=CurvePoint)
N = TypeVar("N", bound=nn.Module)


class Training(ABC, Generic[N, P]):
    """One training in one folder."""

    PANELS: ClassVar[Panels]
    COLUMNS: ClassVar[int] = 4
    """Most panels beside each other."""
    MAY_CHANGE: ClassVar[Collection[str]] = ("iterations",)
    """Settings by which a training can be made longer, or that are not its own."""
    LABEL: ClassVar[str] = ""
    """Before each line of progress."""

    def __init__(self, folder: Path, kept: Mapping[str, Any], descent: Descent, network: Callable[[], N]) -> None:
        """Begins; ``_resume`` goes on from the checkpoint in the folder.

        Args:
            folder: of checkpoint and curve.
            kept: settings by name, which must be those of the checkpoint.
            descent: how to train.
            network: returns a new one.
        """
        self.folder, self._kept, self._descent = folder, kept, descent
        torch.manual_seed(descent.seed)
        self.network = network().to(memory_format=torch.channels_last)
        self._optimiser = torch.optim.AdamW(
            self.network.parameters(), lr=descent.learning_rate, weight_decay=descent.weight_decay
        )
        self._rng = np.random.default_rng(descent.seed)
        self._half = descent.bfloat16 and has_bfloat16()
        self.iteration = 0
        self.curve: list[P] = []
        self._processor_s = 0.0

    @property
    def checkpoint(self) -> Path:
        """File of the newest checkpoint."""
        return self.folder / "checkpoint.pt"

    def _train(
        self,
        until: int,
        loss: Callable[[], Tensor],
        point: Callable[[CurvePoint], P],
        progress: Progress,
        *,
        first: int = 0,
        last: int | None = None,
        after_point: Callable[[], object] = lambda: None,
    ) -> None:
        """Trains, with a checkpoint and a point of the curve every so many iterations and at the end.

        Args:
            until: number of the last iteration of this call.
            loss: returns the loss of a new batch.
            point: returns a point of the curve, which begins with these fields.
            progress: called after each tenth iteration and each point.
            first: number of the iteration at which the step size rises.
            last: number of the iteration at which it has fallen to 0; None = ``until``.
            after_point: called after each point.
        """
        descent, last, losses = self._descent, until if last is None else last, list[float]()
        began, before, start = time.monotonic(), time.process_time(), self.iteration
        while self.iteration < until:
            rate = step_size(descent.learning_rate, self.iteration - first, last - first, descent.warm_up)
            for group in self._optimiser.param_groups:
                group["lr"] = rate
            losses.append(self._descend(loss()))
            self.iteration += 1
            if self.iteration % 10 == 0:
                left = (time.monotonic() - began) / (self.iteration - start) * (until - self.iteration) / 60.0
                recent = np.mean(losses[-50:])
                progress(f"{self.LABEL}iteration {self.iteration} of {last}, loss {recent:.4f}, {left:.0f} min left")
            if self.iteration % descent.evaluate_every == 0 or self.iteration == until:
                self._processor_s += time.process_time() - before
                self.curve.append(point(CurvePoint(self.iteration, float(np.mean(losses)), round(self._processor_s, 1))))
                before, losses = time.process_time(), []
                self._save()
                progress(f"{self.LABEL}iteration {self.iteration}: {self._summary(self.curve[-1])}")
                after_point()

    @abstractmethod
    def _summary(self, point: P) -> str:
        """Returns the errors of a point in a line."""

    def _state(self) -> dict[str, Any]:
        """Returns what else a checkpoint has."""
        return {}

    def _restore(self, content: Mapping[str, Any]) -> None:
        """Takes that from a checkpoint.

        Raises:
            ConfigError: it is of another training.
        """

    def _descend(self, loss: Tensor) -> float:
        """Makes one step, and returns the loss."""
        self._optimiser.zero_grad(set_to_none=True)
        loss.backward()
        nn.utils.clip_grad_norm_(self.network.parameters(), self._descent.longest)
        self._optimiser.step()
        return float(loss.detach())

    def _save(self) -> None:
        content = {
            "settings": dict(self._kept),
            "network": self.network.state_dict(),
            "optimiser": self._optimiser.state_dict(),
            "rng": self._rng.bit_generator.state,
            "torch_rng": torch.get_rng_state(),
            "iteration": self.iteration,
            "curve": [asdict(point) for point in self.curve],
            "processor_s": self._processor_s,
            **self._state(),
        }
        self.folder.mkdir(parents=True, exist_ok=True)
        with replacing(self.checkpoint) as draft:
            torch.save(content, draft)
        write_curve(self.folder, self.curve, self.PANELS, self.COLUMNS)

    def _resume(self, point: Callable[..., P]) -> None:
        """Goes on from the checkpoint in the folder, if there is one.

        Args:
            point: returns a point of the curve from its fields.

        Raises:
            ConfigError: the checkpoint is of other settings, or cannot be read.
        """
        if not self.checkpoint.exists():
            return
        content = load_checkpoint(self.checkpoint, self._kept, self.MAY_CHANGE)
        try:
            self._restore(content)
            self.network.load_state_dict(content["network"])
            self._optimiser.load_state_dict(content["optimiser"])
            self._rng.bit_generator.state = content["rng"]
            torch.set_rng_state(content["torch_rng"])
            self.iteration = content["iteration"]
            self.curve = [point(**each) for each in content["curve"]]
            self._processor_s = content["processor_s"]
        except (KeyError, TypeError, RuntimeError) as error:
            raise ConfigError(f"{self.checkpoint}: is of another version ({error}); delete it to begin again") from error


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


def write_curve(folder: Path, curve: Sequence[Any], panels: Panels, columns: int) -> None:
    """Writes ``curve.json`` and, with Matplotlib, ``curve.png``.

    Args:
        folder: of the training.
        curve: dataclasses, points with ``iteration`` and the fields of the panels.
        panels: title and fields of each.
        columns: most panels beside each other.
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
