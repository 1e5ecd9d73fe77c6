"""Network, training and export of the filler. They need PyTorch, which ``make setup`` does not install."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gibson_sim.errors import ConfigError
from gibson_sim.filling.fillers import open_filler
from gibson_sim.quoting import duration_text
from gibson_sim_learn.filler.pairs import Pairs
from gibson_sim_learn.filler.settings import PairsSettings, TrainingSettings

torch = pytest.importorskip("torch")  # "could not import 'torch'"
SETTINGS = TrainingSettings(iterations=4, batch=2, crop=32, evaluate_every=2)


def pairs() -> Pairs:
    rng = np.random.default_rng(0)
    shape = (4, 64, 64)
    hole = (rng.random(shape) < 0.3).astype(np.uint8)
    colours = rng.integers(0, 256, (*shape, 3)).astype(np.uint8)
    normals = rng.integers(-127, 128, (*shape, 3)).astype(np.int8)
    return Pairs(colours, colours, rng.integers(0, 5000, shape).astype(np.uint16), normals, hole, colours)


def test_interrupted_training_goes_on_as_if_it_had_not_been(tmp_path: Path) -> None:
    from gibson_sim_learn.filler.training import FillerTraining

    whole = FillerTraining(tmp_path / "whole", SETTINGS, "data")
    whole.run([pairs()], [pairs()])

    class Interrupted(Exception):
        pass

    def interrupt() -> None:
        raise Interrupted

    first = FillerTraining(tmp_path / "parts", SETTINGS, "data")
    with pytest.raises(Interrupted):
        first.run([pairs()], [pairs()], after_point=interrupt)
    second = FillerTraining(tmp_path / "parts", SETTINGS, "data")
    assert second.iteration == 2
    second.run([pairs()], [pairs()])
    for one, other in zip(whole.network.state_dict().values(), second.network.state_dict().values(), strict=True):
        torch.testing.assert_close(one, other)
    assert [point.iteration for point in second.curve] == [2, 4]
    for one, other in zip(whole.best.state_dict().values(), second.best.state_dict().values(), strict=True):
        torch.testing.assert_close(one, other)


def test_training_with_other_pairs_or_settings_is_refused(tmp_path: Path) -> None:
    from gibson_sim_learn.filler.training import FillerTraining

    FillerTraining(tmp_path, SETTINGS, "data").run([pairs()], [pairs()])
    with pytest.raises(ConfigError, match=r"other pairs \(data, here other\); choose another --folder"):
        FillerTraining(tmp_path, SETTINGS, "other")
    with pytest.raises(ConfigError, match=r"another batch \(2\); choose another --folder"):
        FillerTraining(tmp_path, TrainingSettings(iterations=4, batch=3, crop=32, evaluate_every=2), "data")


def test_best_weights_are_those_of_the_best_point_of_the_curve(tmp_path: Path) -> None:
    from gibson_sim_learn.filler.export import write_card
    from gibson_sim_learn.filler.training import FillerTraining

    part, kept = pairs(), []
    training = FillerTraining(tmp_path, SETTINGS, "data")
    training.run([part], [part], after_point=lambda: kept.append({k: v.clone() for k, v in training.mean.state_dict().items()}))
    first, second = training.curve
    best = kept[0] if first.rank >= second.rank else kept[1]
    assert training.best_point is (first if first.rank >= second.rank else second)
    for one, other in zip(training.best.state_dict().values(), best.values(), strict=True):
        torch.testing.assert_close(one, other)
    write_card(tmp_path / "filler.md", SETTINGS, training, 4, PairsSettings(shards=2))
    card = (tmp_path / "filler.md").read_text()
    assert f"those of iteration {training.best_point.iteration}," in card and "hash `data`" in card
    assert "`gibson-sim learn filler pairs --shards 2`" in card
    assert "`gibson-sim learn filler train --iterations 4 --batch 2 --crop 32 --evaluate-every 2`" in card
    assert f"4 of 4 iterations, {duration_text(second.processor_s)} of processor time, evaluated every 2 iterations;" in card


def test_fewer_iterations_than_the_training_in_the_folder_has_are_refused(tmp_path: Path) -> None:
    from gibson_sim_learn.filler.training import FillerTraining

    FillerTraining(tmp_path, SETTINGS, "data").run([pairs()], [pairs()])
    with pytest.raises(
        ConfigError, match="holds a training of 4 iterations, more than the 2 of the settings; set 4 iterations or"
    ):
        FillerTraining(tmp_path, replace(SETTINGS, iterations=2), "data")
    assert FillerTraining(tmp_path, SETTINGS, "data").iteration == 4


def test_a_changed_interval_between_evaluations_is_stated(tmp_path: Path) -> None:
    from gibson_sim_learn.filler.training import FillerTraining
    from gibson_sim_learn.training import CurvePoint, intervals_text

    FillerTraining(tmp_path, SETTINGS, "data").run([pairs()], [pairs()])
    second = FillerTraining(tmp_path, replace(SETTINGS, iterations=7, evaluate_every=1), "data")
    second.run([pairs()], [pairs()])
    assert intervals_text(second.curve) == "every 2 iterations to 4, 1 to 7"
    assert intervals_text([CurvePoint(at, 0.0, 0.0) for at in (5, 10, 12)]) == "every 5 iterations to 10, 2 to 12"
    assert intervals_text(second.curve[:1]) == "every 2 iterations"


def test_a_mirrored_cutting_has_mirrored_normals() -> None:
    from gibson_sim_learn.filler.training import batch_of

    part = pairs()
    # Normals that point to where in the image they are: -127 on the left, 127 on the right; nothing is a hole.
    across = np.linspace(-127, 127, 64).round().astype(np.int8)
    normals = np.zeros_like(part.normals)
    normals[..., 0] = across
    given = Pairs(part.drawn, part.filled, part.depth_mm, normals, np.zeros_like(part.hole), part.truth)
    values, truth = batch_of([given], np.random.default_rng(0), 16, 64)
    # A mirrored image of a normal that points to the right at the right: to the left at the left, so the order is the same.
    assert np.allclose(values[:, 4, 0], across / 127.0, atol=1e-6)
    # Input and truth are equal here, and stay so whatever is done to their colours.
    assert np.allclose(values[:, :3], truth, atol=1e-5) and (values[:, 7] == 0.0).all()
    assert len({image.tobytes() for image in truth}) > 4


def test_exported_network_runs_in_the_simulator_and_gives_what_the_network_gives(tmp_path: Path) -> None:
    pytest.importorskip("onnx", reason="could not import 'torch' with its exporter onnx")
    from gibson_sim.filling.inputs import network_input
    from gibson_sim_learn.filler.export import export_network
    from gibson_sim_learn.filler.network import FillerNetwork, multiplications

    torch.manual_seed(0)
    network = FillerNetwork().eval()
    torch.nn.init.normal_(network.exit.weight, std=0.02)
    size = export_network(network, tmp_path / "filler.onnx", SETTINGS, "data", 4)
    assert size < 5_000_000 and 0.25e9 < multiplications(network, 256) < 1e9
    rng = np.random.default_rng(1)
    colour, hole = rng.integers(0, 256, (64, 96, 3)).astype(np.uint8), (rng.random((64, 96)) < 0.2).astype(np.uint8)
    depth, normals = rng.uniform(0.5, 4.0, (64, 96)).astype(np.float32), np.zeros((64, 96, 3), np.float32)
    found = open_filler(str(tmp_path / "filler.onnx")).fill(colour, depth, normals, hole, with_depth=False).colour
    with torch.inference_mode():
        expected = network(torch.from_numpy(network_input(colour, depth, normals, hole)))[0].permute(1, 2, 0).numpy()
    difference = np.abs(found - 255.0 * np.clip(expected, 0.0, 1.0))
    assert difference.max() <= 0.51 and np.abs(found.astype(int) - colour)[hole == 0].max() > 3


def test_loss_is_the_squared_error_with_double_weight_in_holes() -> None:
    from gibson_sim_learn.filler.training import loss_of

    truth, hole = torch.zeros(2, 3, 8, 8), torch.zeros(2, 1, 8, 8)
    found = truth.clone()
    found[0], hole[0] = 0.2, 1.0  # one image is a hole with an error of 0.2, the other is right
    assert float(loss_of(found, truth, hole)) == pytest.approx(2.0 * 0.2**2 / (2.0 + 1.0))
    # Neighbouring columns that differ by 0.3 add the squared difference, 7 of 7 steps in one direction at full size alone.
    stripes = 0.3 * (torch.arange(8) % 2) * torch.ones(2, 3, 8, 1)
    assert float(loss_of(stripes, truth, torch.zeros_like(hole))) == pytest.approx(0.3**2 / 2.0 + 0.5 / 3.0 * 0.3**2)


def test_the_consistency_loss_compares_the_image_of_a_moved_input_with_the_moved_image(tmp_path: Path) -> None:
    from gibson_sim_learn.filler.training import FillerTraining, batch_of

    plain, steady = (
        FillerTraining(tmp_path / str(weight), replace(SETTINGS, consistency=weight), "data") for weight in (0.0, 4.0)
    )
    values, truth = batch_of([pairs()], np.random.default_rng(3), 2, 32)
    untrained = [training._loss(values, truth).item() for training in (plain, steady)]
    assert untrained[0] == pytest.approx(untrained[1], abs=1e-6), (
        "an untrained network returns the colours of its input, moved or not"
    )
    for training in (plain, steady):
        torch.nn.init.normal_(training.network.exit.weight, std=0.05, generator=torch.Generator().manual_seed(1))
    changed = [training._loss(values, truth).item() for training in (plain, steady)]
    assert changed[1] > changed[0] + 0.001


def test_a_moved_input_keeps_its_masks_and_has_no_normals_in_holes() -> None:
    from gibson_sim_learn.filler.training import batch_of, motion_grid, moved_inputs

    inputs = torch.from_numpy(batch_of([pairs()], np.random.default_rng(3), 2, 32)[0])
    still = torch.nn.functional.affine_grid(torch.eye(2, 3).repeat(2, 1, 1), [2, 1, 32, 32], align_corners=False)
    torch.testing.assert_close(moved_inputs(inputs, still), inputs, atol=1e-4, rtol=0.0)
    grid = motion_grid(np.random.default_rng(4), 2, 32)
    moved = moved_inputs(inputs, grid)
    assert set(moved[:, 7:].unique().tolist()) <= {0.0, 1.0} and not torch.equal(moved, inputs)
    assert float((moved[:, 4:7] * moved[:, 7:8]).abs().max()) == 0.0
    assert float((grid - still).abs().max()) < 0.5
