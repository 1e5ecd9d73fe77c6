"""Writes a trained network as ONNX, and its card. Needs PyTorch and onnx.

Inputs: ``present`` (1, 64, 96, 3) and ``recorded`` (K, 64, 96, 3), uint8, RGB; with a network of free distances also ``earlier``
(1, 64, 96, 3), an earlier image warped onto the present one, black where unknown. Outputs: ``pose`` (K, 3), ``scale`` (K, 3),
``match`` (K,), ``hit`` (24, bins + 1), as ``gibson_path_following.policies.path_model.Prediction`` describes them.
"""

from __future__ import annotations

import io
import math
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import onnx
import torch
from torch import Tensor, nn

from gibson_path_following.localisation.pose_filter import OffsetCalibration
from gibson_sim.quoting import duration_text
from gibson_sim.writing import write_file
from gibson_sim_learn.path_following.data import FREE_EDGES
from gibson_sim_learn.path_following.distances.network import DistanceNetwork
from gibson_sim_learn.path_following.distances.training import DistancePoint
from gibson_sim_learn.path_following.drawing import CAMERA_HEIGHT, HEIGHT, HFOV, WIDTH
from gibson_sim_learn.path_following.network import PathNetwork
from gibson_sim_learn.path_following.settings import TrainingSettings, as_dict, load_settings
from gibson_sim_learn.path_following.split import HELD_OUT, TRAINING, VALIDATION
from gibson_sim_learn.path_following.training import PathPoint
from gibson_sim_learn.training import parameter_count

_OPSET = 17


def command_of(settings: TrainingSettings) -> str:
    """Returns the command that trains such a network, Markdown; settings that are not those of the package need a file."""
    if settings == load_settings(None, settings.seed):
        return f"`gibson-sim learn path-following --seed {settings.seed}`"
    return f"`gibson-sim learn path-following --config FILE --seed {settings.seed}`, where FILE has the settings below"


def export_network(network: PathNetwork, file: Path, offsets: OffsetCalibration, distances: DistanceNetwork | None = None) -> int:
    """Writes a network as ONNX; returns the size of the file, bytes.

    Args:
        network: predicts poses.
        file: ONNX file.
        offsets: calibration of its lateral offsets; written into the metadata, for the robot.
        distances: predicts free distances; None = ``network`` does, by its first estimate.
    """
    parts: list[nn.Module] = [network] if distances is None else [network, distances]
    was_training = [part.training for part in parts]
    names = ["present", "recorded"] if distances is None else ["present", "recorded", "earlier"]
    arguments = tuple(torch.zeros(4 if name == "recorded" else 1, HEIGHT, WIDTH, 3, dtype=torch.uint8) for name in names)
    buffer: Any = io.BytesIO()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the exporter that PyTorch recommends instead needs further packages
        torch.onnx.export(
            _Exported(network, distances).eval(),
            arguments,
            buffer,
            input_names=names,
            output_names=["pose", "scale", "match", "hit"],
            dynamic_axes={name: {0: "recorded_images"} for name in ("recorded", "pose", "scale", "match")},
            opset_version=_OPSET,
            dynamo=False,
        )
    for part, mode in zip(parts, was_training, strict=True):
        part.train(mode)
    model = onnx.load_from_string(buffer.getvalue())
    edges = ",".join(f"{edge:.4g}" for edge in FREE_EDGES)
    metadata = {
        "hfov_deg": f"{math.degrees(HFOV):g}",
        "camera_height": f"{CAMERA_HEIGHT:g}",
        "free_edges": edges,
        "offset_ratio": f"{offsets.ratio:.3f}",
        "offset_deviation": f"{offsets.deviation:.3f}",
        "license": "Apache-2.0",
    }
    for key, value in metadata.items():
        entry = model.metadata_props.add()
        entry.key, entry.value = key, value
    onnx.checker.check_model(model)
    content = model.SerializeToString()
    write_file(file, content)
    return len(content)


def write_card(
    file: Path,
    settings: TrainingSettings,
    networks: tuple[PathNetwork, DistanceNetwork],
    points: tuple[PathPoint, DistancePoint],
    offsets: OffsetCalibration,
    data: Mapping[str, int],
    results: Sequence[str] = (),
) -> None:
    """Writes the card of a network, Markdown.

    Args:
        file: Markdown file.
        settings: settings of the training.
        networks: networks of poses and of free distances.
        points: the last points of their curves.
        offsets: calibration of the lateral offsets.
        data: name of a quantity of the data -> number.
        results: further lines on how it drives.
    """
    point, free = points
    weights = [parameter_count(network) for network in networks]
    lines = [
        "# Card of the path-following network",
        "",
        "- **Intended use**: following a path recorded as images, indoors, with a pinhole camera about 0.46 m above the floor. "
        "The network only perceives; planning is geometric.",
        "- **Not intended for**: safety functions. Free distances are estimates of a small network: a robot needs a bumper or a safety scanner.",
        f"- **Size**: {weights[0]} weights for relative poses, {weights[1]} for free distances; float32.",
        f"- **Trained in**: {', '.join(TRAINING)}, domain `trained`. **Validated in**: {', '.join(VALIDATION)}. "
        f"**Held out**: {', '.join(HELD_OUT)}.",
        f"- **Data**: {', '.join(f'{number} {name}' for name, number in data.items())}; rendered by Gibson Sim, no photographs.",
        f"- **Command**: {command_of(settings)}",
        f"- **Training**: {point.iteration} iterations, {duration_text(point.processor_s)} of processor time; free "
        f"distances: {free.iteration}, {duration_text(free.processor_s)}.",
        "- **Settings**: " + ", ".join(f"{name} {value}" for name, value in as_dict(settings).items()),
        "- **Licence**: Apache-2.0, as Gibson Sim.",
        "",
        "| error on the validation scenes | |",
        "|---|---|",
        f"| longitudinal error, median | {point.ahead:.3f} m |",
        f"| lateral error, median | {point.beside:.3f} m |",
        f"| lateral offset, predicted by true; deviation after division by that | {offsets.ratio:.2f}; {offsets.deviation:.2f} m |",
        f"| heading error, median | {point.yaw_deg:.1f} degrees |",
        f"| same place or not, accuracy | {100.0 * point.match:.1f} % |",
        f"| free distance error, median | {free.free:.3f} m |",
        f"| obstacle within 1 m, predicted distance at least 1.3 times the true one | {100.0 * free.too_far:.1f} % of the bearings |",
        f"| free for 1 m, predicted distance below {1.0 / 1.3:.2f} m | {100.0 * free.too_near:.1f} % of the bearings |",
        f"| the same two in close-up images of obstacles | {100.0 * free.obstacles_too_far:.1f} % and "
        f"{100.0 * free.obstacles_too_near:.1f} % |",
        "",
        *results,
    ]
    write_file(file, "\n".join(lines).rstrip() + "\n")


class _Exported(nn.Module):
    """Both networks as one module."""

    def __init__(self, network: PathNetwork, distances: DistanceNetwork | None) -> None:
        super().__init__()
        self.network, self.distances = network, distances

    def forward(self, present: Tensor, recorded: Tensor, earlier: Tensor | None = None) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        here, there = self.network.encode(present), self.network.encode(recorded)
        estimate = self.network.compare(here.expand(there.shape[0], -1, -1, -1), there)
        logits = self.network.free(here) if self.distances is None else self.distances(present, earlier)
        hit = torch.softmax(logits[0], dim=1)
        return estimate.pose, estimate.scale, torch.sigmoid(estimate.match), hit
