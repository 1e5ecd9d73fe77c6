"""Writes trained Goggles as ONNX, and their model card. Needs PyTorch and onnx.

Inputs: ``image`` (1, H, W, 3), uint8, sRGB, H and W even, and ``small`` (1, 64, 96, 3), uint8, its thumbnail. Output: ``adapted``
(1, H, W, 3), uint8, sRGB, the adapted image.
"""

from __future__ import annotations

import io
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import onnx
import torch
from torch import Tensor, nn

from gibson_sim.quoting import duration_text
from gibson_sim.writing import write_file
from gibson_sim_learn.goggles.network import SMALL, GogglesNetwork
from gibson_sim_learn.goggles.pairs import TRAINING_DOMAINS
from gibson_sim_learn.goggles.settings import GogglesSettings, as_dict
from gibson_sim_learn.goggles.training import GogglesPoint
from gibson_sim_learn.path_following.split import HELD_OUT, TRAINING, VALIDATION
from gibson_sim_learn.training import parameter_count

_OPSET = 17


def export_network(network: GogglesNetwork, file: Path) -> int:
    """Writes a network as ONNX; returns the size of the file, bytes."""
    was_training = network.training
    small = torch.zeros(1, *SMALL, 3, dtype=torch.uint8)
    buffer: Any = io.BytesIO()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the exporter that PyTorch recommends instead needs further packages
        torch.onnx.export(
            _Exported(network).eval(),
            (torch.zeros(1, 48, 80, 3, dtype=torch.uint8), small),
            buffer,
            input_names=["image", "small"],
            output_names=["adapted"],
            dynamic_axes={name: {1: "height", 2: "width"} for name in ("image", "adapted")},
            opset_version=_OPSET,
            dynamo=False,
        )
    network.train(was_training)
    model = onnx.load_from_string(buffer.getvalue())
    entry = model.metadata_props.add()
    entry.key, entry.value = "license", "Apache-2.0"
    onnx.checker.check_model(model)
    content = model.SerializeToString()
    write_file(file, content)
    return len(content)


def write_card(
    file: Path,
    settings: GogglesSettings,
    network: GogglesNetwork,
    point: GogglesPoint,
    pairs: int,
    scores: Mapping[str, Mapping[str, str]],
) -> None:
    """Writes the model card of a network, Markdown.

    Args:
        file: path of the card.
        settings: settings of the training.
        network: the network.
        point: the last point of its training curve.
        pairs: number of training pairs.
        scores: evaluation set, as domain and size -> method -> its metrics.
    """
    lines = [
        "# Model card of Goggles",
        "",
        "- **Intended use**: adapting indoor images of a pinhole camera to the appearance of Gibson Sim's images: exposure, white balance, lighting, "
        "vignetting.",
        "- **Not intended for**: removing noise or blur; images in the dark, true colours, other camera models; the content of clipped "
        "or black pixels is invented.",
        f"- **Size**: {parameter_count(network)} weights, float32.",
        f"- **Training scenes**: {', '.join(TRAINING)}, lighting and cameras of the domains {', '.join(f'`{name}`' for name in TRAINING_DOMAINS)}. "
        f"**Validation scenes**: {', '.join(VALIDATION)}. **Held out**: {', '.join(HELD_OUT)}.",
        f"- **Data**: {pairs} pairs of 96x64 pixels; rendered by Gibson Sim, no photographs.",
        f"- **Command**: `gibson-sim learn goggles --seed {settings.seed} --iterations {settings.iterations}`",
        f"- **Training**: {point.iteration} iterations, {duration_text(point.processor_s)} of processor time.",
        "- **Settings**: " + ", ".join(f"{name} {value}" for name, value in as_dict(settings).items()),
        "- **Licence**: Apache-2.0, as Gibson Sim.",
        "",
        *score_table(scores),
    ]
    write_file(file, "\n".join(lines).rstrip() + "\n")


def score_table(scores: Mapping[str, Mapping[str, str]]) -> list[str]:
    """Returns the lines of a Markdown table; for ``scores`` see ``write_card``."""
    rows = dict.fromkeys(name for column in scores.values() for name in column)
    return [
        f"| on the validation scenes | {' | '.join(f'`{domain}`' for domain in scores)} |",
        f"|---|{'---|' * len(scores)}",
        *(f"| {row} | {' | '.join(column.get(row, '-') for column in scores.values())} |" for row in rows),
    ]


class _Exported(nn.Module):
    """The network with uint8 images as input and output."""

    def __init__(self, network: GogglesNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, image: Tensor, small: Tensor) -> Tensor:
        adapted = self.network(image, small).permute(0, 2, 3, 1)
        return (adapted.clamp(0.0, 1.0) * 255.0).round().to(torch.uint8)
