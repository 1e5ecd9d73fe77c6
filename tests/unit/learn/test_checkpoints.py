"""Checkpoints of all trainings: they run no code, and a full disk leaves the previous one. They need PyTorch."""

from __future__ import annotations

import errno
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from gibson_sim.errors import ConfigError, WriteError

torch = pytest.importorskip("torch")  # "could not import 'torch'"


class Code:
    """Creates a file when it is unpickled."""

    def __init__(self, file: Path) -> None:
        self.file = file

    def __reduce__(self) -> tuple[Any, ...]:
        return os.mkdir, (str(self.file),)


def trainings(folder: Path) -> list[Any]:
    from gibson_sim_learn.filler.settings import TrainingSettings as FillerSettings
    from gibson_sim_learn.filler.training import FillerTraining
    from gibson_sim_learn.goggles.settings import GogglesSettings
    from gibson_sim_learn.goggles.training import GogglesTraining
    from gibson_sim_learn.path_following.distances.training import DistanceTraining
    from gibson_sim_learn.path_following.settings import TrainingSettings
    from gibson_sim_learn.path_following.training import PathTraining

    return [
        FillerTraining(folder / "filler", FillerSettings(), "data"),
        GogglesTraining(folder / "goggles", GogglesSettings()),
        PathTraining(folder / "path", TrainingSettings()),
        DistanceTraining(folder / "distances", TrainingSettings()),
    ]


def test_every_training_resumes_from_tensors_and_plain_values(tmp_path: Path) -> None:
    for training in trainings(tmp_path):
        training.iteration = 3
        training._rng.random()
        training._save()
        content = torch.load(training.checkpoint, weights_only=True)
        assert content["rng"] == training._rng.bit_generator.state
    assert [training.iteration for training in trainings(tmp_path)] == [3, 3, 3, 3]


@pytest.mark.parametrize("key", ["settings", "rng", "more"])
def test_a_checkpoint_with_code_is_refused_in_one_line_and_the_code_does_not_run(tmp_path: Path, key: str) -> None:
    for training in trainings(tmp_path):
        training._save()
        content = torch.load(training.checkpoint, weights_only=True)
        torch.save(content | {key: Code(tmp_path / "ran")}, training.checkpoint)
        with pytest.raises(ConfigError) as error:
            trainings(tmp_path)
        assert str(error.value) == (
            f"{training.checkpoint}: cannot be loaded: it holds posix.mkdir, and may hold only tensors and plain values; "
            "delete it to start anew"
        )
        training.checkpoint.unlink()
    assert not (tmp_path / "ran").exists()


@pytest.mark.parametrize("content", [b"", b"garbage", b"PK\x03\x04 cut"])
def test_a_damaged_checkpoint_is_refused_in_one_line(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "filler").mkdir()
    (tmp_path / "filler" / "checkpoint.pt").write_bytes(content)
    with pytest.raises(ConfigError, match=r"checkpoint\.pt: cannot be loaded: .*; delete it to start anew") as error:
        trainings(tmp_path)
    assert "\n" not in str(error.value) and "weights_only" not in str(error.value)


@pytest.mark.parametrize(
    "content", [[], {}, 3, torch.zeros(2), {"settings": torch.zeros(2)}, {"settings": {"seed": torch.zeros(2)}}]
)
def test_a_file_with_other_content_is_refused_in_one_line(tmp_path: Path, content: object) -> None:
    (tmp_path / "filler").mkdir()
    torch.save(content, tmp_path / "filler" / "checkpoint.pt")
    with pytest.raises(ConfigError, match=r"checkpoint\.pt: is not a checkpoint of a training; delete it to start anew"):
        trainings(tmp_path)


def test_a_checkpoint_of_another_network_is_refused_in_one_line(tmp_path: Path) -> None:
    training = trainings(tmp_path)[0]
    training._save()
    content = torch.load(training.checkpoint, weights_only=True)
    content["network"].popitem()
    torch.save(content, training.checkpoint)
    with pytest.raises(ConfigError, match=r"is from another version .*; delete it to start anew") as error:
        trainings(tmp_path)
    assert "\n" not in str(error.value)


def test_a_full_disk_leaves_the_previous_checkpoint(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    training = trainings(tmp_path)[0]
    training._save()
    before = training.checkpoint.read_bytes()
    training.iteration = 7

    def full(descriptor: int, data: bytes) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "write", full)
    with pytest.raises(WriteError, match=r"cannot write .*checkpoint\.pt: No space left on device .*free disk space"):
        training._save()
    assert training.checkpoint.read_bytes() == before and [p for p in training.folder.iterdir() if ".part" in p.name] == []


def test_no_training_is_resumed_with_fewer_iterations_than_it_has(tmp_path: Path) -> None:
    from gibson_sim_learn.path_following.settings import TrainingSettings
    from gibson_sim_learn.path_following.training import total_iterations

    # 10 before the drives, then rounds of 20, 20 and 30.
    settings = TrainingSettings(iterations=10, dagger_rounds=3, dagger_iterations=20, last_iterations=30)
    assert total_iterations(settings) == 80 and total_iterations(replace(settings, dagger_rounds=0)) == 10
    for training in trainings(tmp_path):
        training.iteration = 10_000_000
        training._save()
        with pytest.raises(ConfigError, match="holds a training of 10000000 iterations, more than the"):
            trainings(tmp_path)
        training.checkpoint.unlink()


def test_the_card_of_path_following_names_a_file_of_settings_if_it_needs_one() -> None:
    pytest.importorskip("onnx", reason="could not import 'torch' with its exporter onnx")
    from gibson_sim_learn.path_following.export import command_of
    from gibson_sim_learn.path_following.settings import load_settings

    settings = load_settings(None, 3)
    assert command_of(settings) == "`gibson-sim learn path-following --seed 3`"
    changed = replace(settings, later=settings.later + 1)
    assert command_of(changed) == "`gibson-sim learn path-following --config FILE --seed 3`, where FILE has the settings below"
