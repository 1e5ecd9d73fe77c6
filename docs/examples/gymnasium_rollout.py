"""A few episodes of a task as a Gymnasium environment, with a random policy. No ROS.

pip install 'gibson_sim[gym]', then python gymnasium_rollout.py [--episodes 2]
"""

import argparse

import gymnasium
import numpy as np

import gibson_sim.tasks.environments  # noqa: F401  registers the environments


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=2)
    args = parser.parse_args()
    environment = gymnasium.make("GibsonSim/PointGoal-v0", scene="flat")
    rng = np.random.default_rng(0)
    for seed in range(args.episodes):
        observation, info = environment.reset(seed=seed)
        goal = info["goal"]
        total, over = 0.0, False
        while not over:
            # Forward speed and yaw rate, -1 to 1 of their maxima. Put your policy here.
            action = np.array([0.5, rng.normal(0.0, 0.5)], dtype=np.float32).clip(-1.0, 1.0)
            observation, reward, succeeded, out_of_time, info = environment.step(action)
            total += float(reward)
            over = succeeded or out_of_time
        print(f"seed {seed}: {goal}; success {succeeded}, return {total:.2f}, observation {observation.shape}")
    environment.close()


if __name__ == "__main__":
    main()
