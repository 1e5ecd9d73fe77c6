"""Learns the task `point-goal` with Stable-Baselines3: SAC from states, PPO from images, then evaluates the policy on fixed seeds. No ROS.

pip install 'gibson_sim[learn]', then python learn_point_goal_sb3.py --folder out/point_goal [--observation rgbd] [--steps N] [--seed N]

A second call with the same folder goes on where the first one ended, up to --steps in all. The folder holds the policy, the scale of
rewards, the steps to learn from, and the learning curve: curve.json, curve.png. docs/learning.md shows what to expect, and how long it
takes.
"""

import argparse
import json
import os
import time
from collections import deque
from functools import partial
from pathlib import Path

import gymnasium
import numpy as np
import torch
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import SubprocVecEnv, VecNormalize

from gibson_sim.tasks.environments import TaskEnvironment

FARTHEST = 5.0  # metres; depth is black there and beyond
WINDOW = 200  # episodes over which success is averaged
TRAINING_HZ = 60  # physics steps a second: half the time of the usual 240 ...
EVALUATION_HZ = 240  # ... which the evaluation has
TRAINING_S = 40  # time limit of a training episode; in the evaluation it is that of the task, 90 s
CONTROL_HZ = 3  # decisions a second
REVERSE = 0.1  # of the speed forwards: enough to get away from what is in front
GAMMA = 0.98  # rewards are dense: 50 decisions, 17 s, are far enough to look ahead
EVALUATION_SEEDS = 1_000_000  # and up; a training seed is drawn from 0 to 2**31, so it is hardly ever one of these


def features(state):
    """Returns numbers of about 1 that a network learns from easily: the goal, speeds, touch, the shortest path, near obstacles.

    Raw metres take many times as many steps. Objects are left out, since the scan sees them.
    """
    forward, left, _, speed, yaw_rate = state[:5]
    away = np.hypot(forward, left)
    goal = [forward / max(away, 1e-3), left / max(away, 1e-3), min(away, 3.0) / 3.0, away / 10.0, 2.0 * speed, yaw_rate / 2.0]
    touch, path, scan = state[20:22], state[22:24], state[24:56]  # with images there is neither path nor scan
    return np.concatenate([goal, touch, path, 1.0 - scan / 2.5, 1.0 / (3.0 * (scan + 0.2))]).astype(np.float32)


class Features(gymnasium.ObservationWrapper):
    """Turns observations into what networks take; colour and depth become one image of four bytes a pixel, which takes little memory."""

    def __init__(self, env):
        super().__init__(env)
        self._images = isinstance(env.observation_space, gymnasium.spaces.Dict)
        state = env.observation_space["state"] if self._images else env.observation_space
        self.observation_space = gymnasium.spaces.Box(-10.0, 10.0, features(np.zeros(state.shape)).shape, dtype=np.float32)
        if self._images:
            height, width, _ = env.observation_space["rgb"].shape
            picture = gymnasium.spaces.Box(0, 255, (height, width, 4), dtype=np.uint8)
            self.observation_space = gymnasium.spaces.Dict({"picture": picture, "state": self.observation_space})

    def observation(self, observation):
        if not self._images:
            return features(observation)
        near = 255.0 * (1.0 - np.minimum(observation["depth"], FARTHEST) / FARTHEST)
        picture = np.concatenate([observation["rgb"], near.astype(np.uint8)], axis=2)
        return {"picture": picture, "state": features(observation["state"])}


class SmallNetwork(BaseFeaturesExtractor):
    """Three convolutions: 5 million multiplications for 128x128 pixels, which a processor core does in about a millisecond."""

    def __init__(self, space):
        channels, height, width = space["picture"].shape
        layers = [(channels, 16, 8, 4), (16, 32, 4, 2), (32, 32, 3, 2)]
        convolutions = [part for a, b, k, s in layers for part in (torch.nn.Conv2d(a, b, k, s), torch.nn.ReLU())]
        seen = torch.nn.Sequential(*convolutions, torch.nn.Flatten())
        with torch.no_grad():
            size = seen(torch.zeros(1, channels, height, width)).shape[1]
        super().__init__(space, 128 + space["state"].shape[0])
        self.seen = torch.nn.Sequential(seen, torch.nn.Linear(size, 128), torch.nn.ReLU())

    def forward(self, observations):
        return torch.cat([self.seen(observations["picture"]), observations["state"]], dim=1)


def environment(observation, step_hz):
    # A rasteriser for each process; more threads would only wait for cores.
    os.environ.setdefault("LP_NUM_THREADS", "1")
    # At 0.5 m/s three decisions a second are enough; an episode has fewer of them, and each matters more, than with the usual ten.
    env = TaskEnvironment("point-goal", observation=observation, control_hz=CONTROL_HZ, step_hz=step_hz, reverse=REVERSE)
    # A robot that is stuck learns nothing new for the rest of 90 s.
    env = env if step_hz == EVALUATION_HZ else gymnasium.wrappers.TimeLimit(env, TRAINING_S * CONTROL_HZ)
    return Monitor(Features(env), info_keywords=("success", "spl", "collisions"))


def new_model(args, envs):
    if args.observation == "state":
        # Learns again and again from all steps, so that few are needed.
        network = {"net_arch": [128, 128]}
        # Rewards of a step are small, about 0.1: a bonus of 1 for random actions, the default at first, would drown them for long.
        more = {
            "ent_coef": "auto_0.01",
            "buffer_size": 300_000,
            "learning_starts": 2_000,
            "train_freq": 1,
            "gradient_steps": 1,
            "batch_size": 256,
        }
        return SAC("MlpPolicy", envs, gamma=GAMMA, policy_kwargs=network, seed=args.seed, device="cpu", **more)
    # Images of all steps would not fit into memory: PPO learns from the last ones.
    network = {"net_arch": [128], "log_std_init": -0.5, "features_extractor_class": SmallNetwork}
    more = {"n_steps": 1024, "batch_size": 256, "n_epochs": 4, "ent_coef": 0.001}
    return PPO("MultiInputPolicy", envs, gamma=GAMMA, policy_kwargs=network, seed=args.seed, device="cpu", **more)


class Progress(BaseCallback):
    """Prints a line now and then, and keeps what is needed to go on."""

    def __init__(self, folder, points, every):
        super().__init__()
        self._folder, self._points, self._every = folder, points, every
        self._ended = deque(maxlen=WINDOW)
        self._episodes, self._seconds = (points[-1]["episodes"], points[-1]["seconds"]) if points else (0, 0.0)

    def _on_training_start(self):
        self._began, self._next = time.perf_counter(), self.num_timesteps + self._every

    def _on_step(self):
        ended = [info["episode"] for info in self.locals["infos"] if "episode" in info]
        self._ended.extend(ended)
        self._episodes += len(ended)
        return True

    def _on_rollout_end(self):
        if self.num_timesteps < self._next or not self._ended:
            return
        self._next = self.num_timesteps + self._every
        names = ("r", "l", "success", "spl", "collisions")
        mean = {name: float(np.mean([episode[name] for episode in self._ended])) for name in names}
        seconds = self._seconds + time.perf_counter() - self._began
        point = {"steps": self.num_timesteps, "seconds": seconds, "episodes": self._episodes, **mean}
        self._points.append(point)
        print(
            "{steps} steps, {seconds:.0f} s, {episodes} episodes; of the last ones {success:.0%} succeeded, return {r:.1f}, "
            "SPL {spl:.2f}, {l:.0f} steps, {collisions:.1f} collisions".format(**point),
            flush=True,
        )
        save(self._folder, self.model, self._points)


def save(folder, model, points):
    """Writes beside the files and renames, so that a process that is killed leaves the previous ones."""
    folder.mkdir(parents=True, exist_ok=True)
    model.save(folder / "new.zip")
    model.get_vec_normalize_env().save(str(folder / "new_rewards.pkl"))
    (folder / "new.json").write_text(json.dumps(points))
    names = [("new_rewards.pkl", "rewards.pkl"), ("new.json", "curve.json"), ("new.zip", "policy.zip")]
    if isinstance(model, SAC):
        model.save_replay_buffer(folder / "new_buffer.pkl")
        names.insert(0, ("new_buffer.pkl", "buffer.pkl"))
    for new, name in names:
        (folder / new).replace(folder / name)


def load(folder, envs):
    """Returns what ``save`` wrote: the model and the points of the curve."""
    envs = VecNormalize.load(str(folder / "rewards.pkl"), envs)
    kind = SAC if (folder / "buffer.pkl").exists() else PPO
    model = kind.load(folder / "policy.zip", envs, device="cpu")
    if isinstance(model, SAC):
        model.load_replay_buffer(folder / "buffer.pkl")
    return model, json.loads((folder / "curve.json").read_text())


def plot(folder, points):
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, left = pyplot.subplots(figsize=(6.4, 3.2), layout="constrained")
    right = left.twinx()
    steps = [point["steps"] / 1e6 for point in points]
    left.plot(steps, [100.0 * point["success"] for point in points], color="tab:blue", label="success")
    right.plot(steps, [point["r"] for point in points], color="tab:orange", label="return")
    left.set(xlabel="million steps", ylabel=f"success, % of {WINDOW} episodes", ylim=(0, 100))
    right.set_ylabel("return")
    figure.legend(loc="outside upper center", ncols=2)
    figure.savefig(folder / "curve.png", dpi=100)


def evaluate(model, args):
    """Returns how the policy does without exploration, one episode for each seed."""
    env = environment(args.observation, EVALUATION_HZ)
    ended = []
    for seed in range(EVALUATION_SEEDS, EVALUATION_SEEDS + args.episodes):
        observation, _ = env.reset(seed=seed)
        over = False
        while not over:
            action, _ = model.predict(observation, deterministic=True)
            observation, _, succeeded, late, info = env.step(action)
            over = succeeded or late
        ended.append(info["episode"])
    env.close()
    return {name: float(np.mean([episode[name] for episode in ended])) for name in ("success", "spl", "collisions", "r")}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, default=Path("out/point_goal"))
    parser.add_argument("--observation", choices=("state", "rgbd"), default="state")
    parser.add_argument("--steps", type=int, default=200_000, help="in all, with those of earlier calls (default: 200000)")
    parser.add_argument("--every", type=int, default=5000, help="steps between lines and files (default: 5000)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--processes", type=int, default=2, help="simulations beside the learning process (default: 2)")
    parser.add_argument("--episodes", type=int, default=100, help="of the evaluation (default: 100)")
    args = parser.parse_args()

    # More threads would spin beside the simulations.
    torch.set_num_threads(1)
    envs = SubprocVecEnv([partial(environment, args.observation, TRAINING_HZ)] * args.processes, start_method="spawn")
    if (args.folder / "policy.zip").exists():
        model, points = load(args.folder, envs)
        # Other episodes than at the beginning.
        model.get_env().seed(args.seed + model.num_timesteps)
    else:
        model, points = new_model(args, VecNormalize(envs, norm_obs=False, gamma=GAMMA)), []
    left = args.steps - model.num_timesteps
    if left > 0:
        model.learn(left, callback=Progress(args.folder, points, args.every), reset_num_timesteps=False)
        save(args.folder, model, points)
        plot(args.folder, points)
    model.get_env().close()
    result = evaluate(model, args)
    (args.folder / "evaluation.json").write_text(json.dumps({"steps": model.num_timesteps, "episodes": args.episodes, **result}))
    print(
        "{} episodes of seeds from {}: {success:.0%} succeeded, SPL {spl:.2f}, {collisions:.1f} collisions, return {r:.1f}".format(
            args.episodes, EVALUATION_SEEDS, **result
        )
    )


if __name__ == "__main__":
    main()
