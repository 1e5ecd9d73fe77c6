"""Writes the trained filler as ONNX, and its model card. Needs PyTorch and onnx.

Input: ``input`` (N, 9, H, W), float32, as made by ``gibson_sim.filling.inputs``, H and W multiples of 16. Output: ``image`` (N, 3, H, W),
float32, sRGB, 0 to 1.
"""

from __future__ import annotations

import io
import warnings
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import onnx
import torch
from torch import Tensor, nn

from gibson_sim.filling.inputs import CHANNELS
from gibson_sim.filling.network import VERSION
from gibson_sim.quoting import duration_text
from gibson_sim.writing import write_file
from gibson_sim_learn.filler.network import FillerNetwork, multiplications
from gibson_sim_learn.filler.settings import PairsSettings, TrainingSettings, options_of
from gibson_sim_learn.filler.training import FillerTraining
from gibson_sim_learn.path_following.split import HELD_OUT, TRAINING, VALIDATION
from gibson_sim_learn.training import intervals_text, parameter_count

_OPSET = 17


def command_of(settings: TrainingSettings) -> str:
    """Returns the command that trains a network with these settings."""
    return f"gibson-sim learn filler train{options_of(settings)}"


def export_network(network: FillerNetwork, file: Path, settings: TrainingSettings, data: str, iteration: int) -> int:
    """Writes a network as ONNX; returns the size of the file, bytes.

    Args:
        network: the network.
        file: path of the ONNX file.
        settings: settings of the training.
        data: hash of the pairs.
        iteration: iteration from which the weights are.
    """
    buffer: Any = io.BytesIO()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the exporter that PyTorch recommends instead needs further packages
        torch.onnx.export(
            _Exported(network).eval(),
            (torch.zeros(1, CHANNELS, 48, 80),),
            buffer,
            input_names=["input"],
            output_names=["image"],
            dynamic_axes={name: {0: "images", 2: "height", 3: "width"} for name in ("input", "image")},
            opset_version=_OPSET,
            dynamo=False,
        )
    model = onnx.load_from_string(buffer.getvalue())
    for key, value in {
        "gibson_filler": VERSION,
        "data": data,
        "command": command_of(settings),
        "seed": str(settings.seed),
        "iteration": str(iteration),
        "license": "Apache-2.0",
    }.items():
        entry = model.metadata_props.add()
        entry.key, entry.value = key, value
    onnx.checker.check_model(model)
    content = model.SerializeToString()
    write_file(file, content)
    return len(content)


def write_card(
    file: Path,
    settings: TrainingSettings,
    training: FillerTraining,
    pairs: int,
    pairs_settings: PairsSettings,
    results: Sequence[str] = (),
) -> None:
    """Writes the card of a network, Markdown.

    Args:
        file: Markdown file.
        settings: settings of the training.
        training: the training; its curve has at least one point.
        pairs: number of training pairs.
        pairs_settings: settings of the pairs.
        results: further lines, such as results on held-out scenes.
    """
    point, best = training.curve[-1], training.best_point
    lines = [
        "# Card of the filler",
        "",
        "- **Intended use**: filling holes and reducing artefacts in images of indoor scans that the simulator renders.",
        "- **Not intended for**: measuring or detecting objects: the content of a hole is invented.",
        f"- **Size**: {parameter_count(training.best)} weights, float32; {multiplications(training.best, 256) / 1e9:.2f} billion multiplications for "
        "256x256 pixels.",
        f"- **Trained in**: {', '.join(TRAINING)}. **Validated in**: {', '.join(VALIDATION)}. **Held out**: {', '.join(HELD_OUT)}.",
        f"- **Data**: {pairs} pairs of 256x256 pixels from simulated scans (preset `kinect`, textured), hash `{training.data}`; "
        "rendered by Gibson Sim, no photographs.",
        f"- **Command**: `gibson-sim learn filler pairs{options_of(pairs_settings)}`, `{command_of(settings)}`",
        f"- **Training**: {point.iteration} of {settings.iterations} iterations, {duration_text(point.processor_s)} of processor time, "
        f"evaluated {intervals_text(training.curve)}; the weights are those of iteration {best.iteration}, the best on the validation scenes.",
        "- **Settings**: "
        + ", ".join(f"{name} {value}" for name, value in asdict(settings).items() if name not in FillerTraining.MAY_CHANGE),
        f"- **On the validation scenes**: holes {best.hole_psnr:.2f} dB, seen {best.seen_psnr:.2f} dB, GMSD {best.gmsd:.3f}.",
        "- **Licence**: Apache-2.0, as Gibson Sim.",
        "",
        *results,
    ]
    write_file(file, "\n".join(lines).rstrip() + "\n")


class _Exported(nn.Module):
    """The network with its output clipped to 0 to 1."""

    def __init__(self, network: FillerNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, values: Tensor) -> Tensor:
        return torch.clamp(self.network(values), 0.0, 1.0)
