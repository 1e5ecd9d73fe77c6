"""Learns the task `point-goal` with PPO of RLlib, on this machine or on a Ray cluster. No ROS.

pip install 'gibson_sim[gym]' "ray[rllib]" torch, then python learn_point_goal_rllib.py --folder out/point_goal_rllib [--steps N] [--seed N]

A second call with the same folder goes on where the first one ended. With --address, simulations run on the machines of that cluster, on
which Gibson Sim has to be installed, too.
"""

import argparse
import math
import os
from pathlib import Path

import ray
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.callbacks.callbacks import RLlibCallback
from ray.rllib.connectors.env_to_module import MeanStdFilter
from ray.rllib.core.rl_module.default_model_config import DefaultModelConfig
from ray.tune.registry import register_env

WINDOW = 200  # episodes over which success is averaged


def environment(settings):
    # Imported where the simulations run.
    from gibson_sim.tasks.environments import TaskEnvironment

    os.environ.setdefault("LP_NUM_THREADS", "1")
    return TaskEnvironment("point-goal", **settings)


class Success(RLlibCallback):
    """Adds the fraction of episodes that succeeded to the results."""

    def on_episode_end(self, *, episode, metrics_logger, **others):
        metrics_logger.log_value("success", float(episode.get_infos(-1)["success"]), window=WINDOW)


def settings(args):
    network = DefaultModelConfig(fcnet_hiddens=[128, 128], fcnet_activation="tanh")
    return (
        PPOConfig()
        # learn_point_goal_sb3.py says why.
        .environment("point-goal", env_config={"control_hz": 3, "step_hz": 60, "reverse": 0.1})
        .env_runners(num_env_runners=args.processes, env_to_module_connector=lambda env, spaces, device: MeanStdFilter())
        .training(lr=3e-4, gamma=0.98, train_batch_size_per_learner=args.batch, minibatch_size=256, num_epochs=10)
        .rl_module(model_config=network)
        .callbacks(Success)
        .debugging(seed=args.seed)
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, default=Path("out/point_goal_rllib"))
    parser.add_argument("--steps", type=int, default=1_000_000, help="in all, with those of earlier calls (default: 1000000)")
    parser.add_argument("--batch", type=int, default=4096, help="steps of an iteration (default: 4096)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--processes", type=int, default=2, help="simulations beside the learning process (default: 2)")
    parser.add_argument("--address", help="of a Ray cluster (default: this machine alone)")
    args = parser.parse_args()

    # Each simulation asks for a core; the learning process waits while they work, so it needs none of its own.
    ray.init(address=args.address, num_cpus=None if args.address else args.processes + 1, include_dashboard=False)
    register_env("point-goal", environment)
    learner = settings(args).build_algo()
    if (args.folder / "algorithm_state.pkl").exists():
        learner.restore_from_path(str(args.folder.resolve()))
    steps = 0
    while steps < args.steps:
        result = learner.train()
        runners = result["env_runners"]
        steps = int(runners["num_env_steps_sampled_lifetime"])
        success, reward = runners.get("success", math.nan), runners.get("episode_return_mean", math.nan)
        told = "no episode has ended yet" if math.isnan(success) else f"{success:.0%} succeeded, return {reward:.1f}"
        print(f"{steps} steps, {result['time_total_s']:.0f} s: {told}", flush=True)
        learner.save_to_path(str(args.folder.resolve()))
    learner.stop()
    ray.shutdown()


if __name__ == "__main__":
    main()
