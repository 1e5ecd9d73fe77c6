"""The whole training by one call: data, training, rounds of DAgger, free distances, the network as ONNX and its card. Needs PyTorch and onnx."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from gibson_path_following.localisation.localiser import Localiser, NodeMatcher
from gibson_path_following.policies.follower import PathFollower
from gibson_path_following.policies.learned import LearnedPolicy
from gibson_path_following.policies.path_model import PathModel
from gibson_path_following.types import RecordedPath
from gibson_sim_learn.path_following.dagger import drive_all
from gibson_sim_learn.path_following.data import Shard, World, draw_shard, make_data
from gibson_sim_learn.path_following.distances.obstacles import draw_obstacle_shard
from gibson_sim_learn.path_following.distances.training import DistancePoint, DistanceTraining
from gibson_sim_learn.path_following.drives import FollowerDriver
from gibson_sim_learn.path_following.export import export_network, write_card
from gibson_sim_learn.path_following.sampling import Sampler
from gibson_sim_learn.path_following.settings import TrainingSettings, as_dict
from gibson_sim_learn.path_following.split import TRAINING, VALIDATION
from gibson_sim_learn.path_following.training import PathPoint, PathTraining
from gibson_sim_learn.training_folder import training_folder

MODEL, CARD = "path_following.onnx", "path_following.md"
"""Files of a training's folder: the network, and its card."""


@dataclass(frozen=True, slots=True)
class Learned:
    """Result of a training."""

    model: Path
    card: Path
    point: PathPoint
    """Errors of poses on the validation scenes."""
    distances: DistancePoint
    """Errors of free distances on the validation scenes."""
    size: int
    """Size of the model, bytes."""


def learn(folder: Path, settings: TrainingSettings, progress: Callable[[str], None] = lambda text: None) -> Learned:
    """Trains in a folder, or resumes there, and writes the network.

    Args:
        folder: folder of data, checkpoint, curve, network and card.
        settings: the configuration.
        progress: called with one line now and then.

    Raises:
        GibsonSimError: nothing can be drawn here, or the folder holds another training, or another process trains in it.
    """
    with training_folder(folder, as_dict(settings), PathTraining.MAY_CHANGE):
        return _learn(folder, settings, progress)


def _learn(folder: Path, settings: TrainingSettings, progress: Callable[[str], None]) -> Learned:
    """Trains in a locked folder, see ``learn``."""
    training = PathTraining(folder, settings)
    data, validation = folder / "data" / "training", folder / "data" / "validation"
    numbers, count = itertools.count(1), 6 + 2 * settings.dagger_rounds

    def stage(name: str) -> Callable[[str], None]:
        """Begins the next stage; returns its function for progress."""
        number = next(numbers)
        return lambda text: progress(f"stage {number} of {count}, {name}: {text}")

    def draw_paths(world: World, number: int) -> Shard:
        return draw_shard(world, settings.seed, number, settings.data)

    def draw_obstacles(world: World, number: int) -> Shard:
        return draw_obstacle_shard(world, settings.seed, number)

    make_data(data, TRAINING, settings.shards, draw_paths, stage("data"))
    make_data(validation, VALIDATION, settings.validation_shards, draw_paths, stage("validation data"))
    judge = Sampler.of_folders([validation])
    training.run(Sampler.of_folders([data]), judge, settings.iterations, stage("training"))
    driven = [folder / "data" / f"dagger-{number + 1}" for number in range(settings.dagger_rounds)]
    for number, drives in enumerate(driven):
        drive_progress = stage("drives")
        if training.round == number:
            _drive(drives, folder / f"round-{number}.onnx", training, judge, number, drive_progress)
            training.begin_round()
        steps = settings.last_iterations if number + 1 == len(driven) else settings.dagger_iterations
        until = settings.iterations + number * settings.dagger_iterations + steps
        training.run(Sampler.of_folders([data, *driven[: number + 1]]), judge, until, stage("training"))
    every = Sampler.of_folders([data, *driven])
    obstacles, judged = folder / "data" / "obstacles", folder / "data" / "obstacles-validation"
    make_data(obstacles, TRAINING, settings.distances.obstacle_shards, draw_obstacles, stage("obstacles"))
    make_data(judged, VALIDATION, settings.validation_shards, draw_obstacles, stage("validation obstacles"))
    close = Sampler.of_folders([obstacles])
    distances = DistanceTraining(folder / "distances", settings)
    distances.run(every, close, (judge, Sampler.of_folders([judged])), stage("distances"))
    offsets = training.offsets(judge)
    size = export_network(training.network, folder / MODEL, offsets, distances.network)
    points = training.curve[-1], distances.curve[-1]
    counts = {"images": every.image_count, "pairs": every.pair_count, "images of obstacles": close.image_count}
    write_card(folder / CARD, settings, (training.network, distances.network), points, offsets, counts)
    return Learned(folder / MODEL, folder / CARD, *points, size)


def _drive(
    folder: Path, model: Path, training: PathTraining, judge: Sampler, number: int, progress: Callable[[str], None]
) -> None:
    """Runs the drives of a DAgger round with the present network; an interrupted round resumes with the same network."""
    if not model.is_file():
        export_network(training.network, model, training.offsets(judge))
    network, settings = PathModel(model), training.settings

    def driver_of(path: RecordedPath) -> FollowerDriver:
        nodes = NodeMatcher(path)
        policy = LearnedPolicy(path, network, nodes=nodes)
        return FollowerDriver(PathFollower(path, policy, localiser=Localiser(path, nodes=nodes)))

    drive_all(folder, TRAINING, settings.dagger_drives, settings.seed + number + 1, driver_of, progress)
