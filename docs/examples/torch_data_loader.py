"""Batches of colour, depth and semantic classes from random drives, for training with PyTorch: each worker of the loader simulates its own. No ROS.

pip install torch, then python torch_data_loader.py [--scene linden_flat] [--workers 2] [--batches 5]
"""

import argparse
import itertools
from collections.abc import Iterator

import numpy as np
import torch
from torch.utils.data import DataLoader, IterableDataset, get_worker_info

import gibson_sim as gs


class DrivenViews(IterableDataset):
    """Endless: equal seeds give equal images, and every worker has a seed of its own."""

    def __init__(self, scene: str, seed: int = 0, width: int = 160, height: int = 120) -> None:
        self.scene, self.seed, self.size = scene, seed, (width, height)

    def __iter__(self) -> Iterator[dict[str, torch.Tensor]]:
        worker = get_worker_info()
        rng = np.random.default_rng([self.seed, worker.id if worker else 0])
        pose = gs.camera_pose((0.12, 0.0, 0.5), look_at=(1.0, 0.0, 0.45))  # in the frame of the link
        with gs.Simulation(self.scene, seed=self.seed) as sim:
            eye = gs.CameraSpec("eye", "robot/base_link", pose, *self.size)
            while True:
                ranges = sim.scan().ranges  # one ray a degree, counterclockwise from straight ahead
                blocked = min(ranges[:30].min(), ranges[-30:].min()) < 0.5
                sim.command(linear=-0.2 if blocked else 0.4, angular=rng.normal(0.0, 2.0 if blocked else 0.6))
                sim.step(seconds=0.5)
                frame = sim.render(eye, outputs=["rgb", "depth", "semantic"])
                yield {
                    "rgb": torch.from_numpy(frame.rgb).permute(2, 0, 1) / 255.0,
                    "depth": torch.from_numpy(frame.depth).nan_to_num(posinf=0.0)[None],  # 0 = nothing seen
                    "semantic": torch.from_numpy(frame.semantic.astype(np.int64)),  # indices into sim.semantic_classes
                }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", default="linden_flat")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--batches", type=int, default=5)
    args = parser.parse_args()
    # A process that is forked cannot use OpenGL if its parent has: workers are spawned.
    context = "spawn" if args.workers else None
    loader = DataLoader(DrivenViews(args.scene), batch_size=8, num_workers=args.workers, multiprocessing_context=context)
    for number, batch in enumerate(itertools.islice(loader, args.batches)):
        shapes = ", ".join(f"{name} {tuple(tensor.shape)}" for name, tensor in batch.items())
        print(f"batch {number}: {shapes}; mean depth {batch['depth'][batch['depth'] > 0].mean():.2f} m")


if __name__ == "__main__":
    main()
