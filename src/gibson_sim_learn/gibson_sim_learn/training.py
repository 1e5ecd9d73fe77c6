"""Common part of all trainings: training loop, learning-rate schedule, checkpoints, training curve. Needs PyTorch.

A training has a folder. An interrupted training resumes from its last checkpoint; with the same settings, seed, data and software on the same
kind of processor it gives the result of an uninterrupted one, up to the rounding of sums.
"""

from __future__ import annotations

import io
import json
import math
import operator
import re
import time
import warnings
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
from gibson_sim_learn.remaining import Remaining
from gibson_sim_learn.training_folder import check_settings

Progress = Callable[[str], None]
"""Called with one line now and then."""
Panels = Sequence[tuple[str, Sequence[str]]]
"""Panels of the plot of a training curve: title, and the fields of ``CurvePoint`` that it shows."""


@dataclass(frozen=True, slots=True)
class CurvePoint:
    """Metrics on the validation scenes after some iterations."""

    iteration: int
    loss: float
    """Mean training loss since the previous point."""
    processor_s: float
    """Processor time of the training so far, seconds."""


@dataclass(frozen=True, slots=True)
class OptimiserSettings:
    """Settings of the optimiser, AdamW, and of its schedule."""

    seed: int
    """Random seed of initial weights, sampling and augmentation."""
    learning_rate: float
    """Learning rate after the warm-up."""
    weight_decay: float
    warm_up: int
    """Iterations of linear warm-up of the learning rate."""
    max_gradient_norm: float
    """Norm of the gradient of all weights to which larger gradients are clipped."""
    evaluate_every: int
    """Iterations between two points of the curve, and between two checkpoints."""
    bfloat16: bool = True
    """Whether to autocast to bfloat16 if the processor supports it."""


P = TypeVar("P", bound=CurvePoint)
N = TypeVar("N", bound=nn.Module)


class Training(ABC, Generic[N, P]):
    """One training in one folder."""

    PANELS: ClassVar[Panels]
    """Panels of the plot of the training curve."""
    COLUMNS: ClassVar[int] = 4
    """Maximum number of panels per row."""
    MAY_CHANGE: ClassVar[Collection[str]] = ("iterations",)
    """Settings that may differ from those of the checkpoint: they extend a training, or do not affect it."""

    def __init__(self, folder: Path, settings: Mapping[str, Any], optimiser: OptimiserSettings, network: Callable[[], N]) -> None:
        """Starts a training; ``_resume`` loads the checkpoint in the folder.

        Args:
            folder: folder of checkpoint and curve.
            settings: settings by name; they are stored in the checkpoint and must equal those of an existing one.
            optimiser: settings of the optimiser and of its schedule.
            network: returns an untrained network.
        """
        self.folder, self._checkpoint_settings, self._optimiser_settings = folder, settings, optimiser
        torch.manual_seed(optimiser.seed)
        self.network = network().to(memory_format=torch.channels_last)
        self._optimiser = torch.optim.AdamW(
            self.network.parameters(), lr=optimiser.learning_rate, weight_decay=optimiser.weight_decay
        )
        self._rng = np.random.default_rng(optimiser.seed)
        self._bfloat16 = optimiser.bfloat16 and has_bfloat16()
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
        """Trains; adds a point to the curve and writes a checkpoint every ``evaluate_every`` iterations and at the end.

        Args:
            until: number of the last iteration of this call.
            loss: samples a batch and returns its loss.
            point: returns a point of the curve; gets the fields of ``CurvePoint``.
            progress: called with one line after each tenth iteration and each point.
            first: number of the iteration at which the learning-rate schedule starts.
            last: number of the iteration at which the learning rate reaches 0; None = ``until``.
            after_point: called after each point.
        """
        settings, last, losses = self._optimiser_settings, until if last is None else last, list[float]()
        remaining, before = Remaining(self.iteration), time.process_time()
        while self.iteration < until:
            rate = learning_rate_at(settings.learning_rate, self.iteration - first, last - first, settings.warm_up)
            for group in self._optimiser.param_groups:
                group["lr"] = rate
            losses.append(self._optimiser_step(loss()))
            self.iteration += 1
            if self.iteration % 10 == 0:
                left = remaining.text(self.iteration, until)
                progress(f"iteration {self.iteration} of {last}, loss {np.mean(losses[-50:]):.4f}{left}")
            if self.iteration % settings.evaluate_every == 0 or self.iteration == until:
                progress(f"iteration {self.iteration} of {last}, evaluating")
                self._processor_s += time.process_time() - before
                self.curve.append(point(CurvePoint(self.iteration, float(np.mean(losses)), round(self._processor_s, 1))))
                before, losses = time.process_time(), []
                self._save()
                progress(f"iteration {self.iteration}: {self._summary(self.curve[-1])}")
                after_point()

    @abstractmethod
    def _summary(self, point: P) -> str:
        """Returns the metrics of a point in one line."""

    def _state(self) -> dict[str, Any]:
        """Returns the additional content of a checkpoint: tensors and plain values."""
        return {}

    def _restore(self, content: Mapping[str, Any]) -> None:
        """Restores the additional content of a checkpoint.

        Raises:
            ConfigError: the checkpoint belongs to another training.
        """

    def _optimiser_step(self, loss: Tensor) -> float:
        """Makes one step of the optimiser; returns the loss."""
        self._optimiser.zero_grad(set_to_none=True)
        loss.backward()
        nn.utils.clip_grad_norm_(self.network.parameters(), self._optimiser_settings.max_gradient_norm)
        self._optimiser.step()
        return float(loss.detach())

    def _save(self) -> None:
        values = {
            "settings": dict(self._checkpoint_settings),
            "rng": self._rng.bit_generator.state,
            "iteration": self.iteration,
            "curve": [asdict(point) for point in self.curve],
            "processor_s": self._processor_s,
        }
        content = {
            **json.loads(json.dumps(values)),  # plain values: load_checkpoint refuses others, such as NumPy's
            "network": self.network.state_dict(),
            "optimiser": self._optimiser.state_dict(),
            "torch_rng": torch.get_rng_state(),
            **self._state(),
        }
        buffer = io.BytesIO()  # torch.save to a file hides the error of a full disk
        torch.save(content, buffer)
        write_file(self.checkpoint, buffer.getvalue())
        write_curve(self.folder, self.curve, self.PANELS, self.COLUMNS)

    def _resume(self, point: Callable[..., P], total: int) -> None:
        """Resumes from the checkpoint in the folder, if there is one.

        Args:
            point: returns a point of the curve from its fields.
            total: number of iterations of the training by its settings.

        Raises:
            ConfigError: the checkpoint has other settings or more iterations, or cannot be read.
        """
        if not self.checkpoint.exists():
            return
        content = load_checkpoint(self.checkpoint, self._checkpoint_settings, self.MAY_CHANGE)
        try:
            self._restore(content)
            self.network.load_state_dict(content["network"])
            self._optimiser.load_state_dict(content["optimiser"])
            self._rng.bit_generator.state = content["rng"]
            torch.set_rng_state(content["torch_rng"])
            self.iteration = operator.index(content["iteration"])
            self.curve = [point(**each) for each in content["curve"]]
            self._processor_s = float(content["processor_s"])
        except (AttributeError, KeyError, TypeError, ValueError, RuntimeError) as error:
            cause = " ".join(str(error).split())
            raise ConfigError(f"{self.checkpoint}: is from another version ({cause}); delete it to start anew") from error
        if self.iteration > total:
            raise ConfigError(
                f"{self.folder}: holds a training of {self.iteration} iterations, more than the {total} of the settings; "
                f"set {self.iteration} iterations or more, or choose another --folder"
            )


def has_bfloat16() -> bool:
    """Returns whether the processor has bfloat16 instructions (AVX-512), from /proc/cpuinfo."""
    try:
        return "avx512_bf16" in Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return False


def learning_rate_at(peak: float, done: int, total: int, warm_up: int) -> float:
    """Returns the learning rate of an iteration: linear warm-up, then cosine decay to 0 at the last iteration.

    Args:
        peak: learning rate after the warm-up.
        done: number of iterations before this one.
        total: total number of iterations.
        warm_up: number of iterations of the warm-up.
    """
    return peak * min(1.0, (done + 1) / warm_up) * 0.5 * (1.0 + math.cos(math.pi * done / max(1, total)))


def intervals_text(curve: Sequence[CurvePoint]) -> str:
    """Returns the intervals between the points of a curve, such as ``every 100 iterations``, or ``every 100 iterations to 400, 50 to 500``."""
    runs: list[tuple[int, int]] = []  # interval, and iteration of the last point after it
    before = 0
    for point in curve:
        interval, before = point.iteration - before, point.iteration
        if runs and runs[-1][0] == interval:
            runs.pop()
        runs.append((interval, before))
    if len(runs) == 1:
        return f"every {runs[0][0]} iterations"
    return "every " + ", ".join(f"{interval}{'' if k else ' iterations'} to {last}" for k, (interval, last) in enumerate(runs))


def load_checkpoint(file: Path, settings: Mapping[str, Any], may_change: Collection[str]) -> dict[str, Any]:
    """Returns the content of a checkpoint whose settings equal those of the training.

    Only tensors and plain values are loaded, so that a checkpoint cannot run code.

    Args:
        file: path of the checkpoint.
        settings: settings of the training that resumes.
        may_change: names of the settings that may differ.

    Raises:
        ConfigError: the checkpoint cannot be read, holds other objects, or has other settings.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # on pickle protocols; the error says enough
            content: dict[str, Any] = torch.load(file, weights_only=True)
    except Exception as error:
        raise ConfigError(f"{file}: cannot be loaded: {_cause_of(error)}; delete it to start anew") from error
    try:
        stored = dict(json.loads(json.dumps(content["settings"])))
    except (IndexError, KeyError, TypeError, ValueError) as error:
        raise ConfigError(f"{file}: is not a checkpoint of a training; delete it to start anew") from error
    check_settings(file.parent, stored, settings, may_change)
    return content


def _cause_of(error: Exception) -> str:
    """Returns why ``torch.load`` failed, in one line: its messages recommend loading without a check, over several lines."""
    text = str(error)
    if found := re.search(r"GLOBAL (\S+)", text):
        return f"it holds {found[1]}, and may hold only tensors and plain values"
    if "weights_only" in text:
        return "it is damaged, or not a checkpoint"
    return " ".join(text.split(". ")[0].split()) or type(error).__name__


def write_curve(folder: Path, curve: Sequence[Any], panels: Panels, columns: int) -> None:
    """Writes ``curve.json`` and, with Matplotlib, ``curve.png``.

    Args:
        folder: folder of the training.
        curve: points, dataclasses with ``iteration`` and the fields of the panels.
        panels: title and fields of each panel.
        columns: maximum number of panels per row.
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


def parameter_count(network: nn.Module) -> int:
    """Returns the number of weights."""
    return sum(parameter.numel() for parameter in network.parameters())
