"""A data set of a drive through a flat: colour, depth in millimetres and camera poses. No ROS.

python camera_data_set.py [FOLDER] [--images 20]
"""

import argparse
import csv
from pathlib import Path

import cv2
import numpy as np

import gibson_sim as gs


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?", default=Path("out/data_set"))
    parser.add_argument("--images", type=int, default=20)
    args = parser.parse_args()
    args.folder.mkdir(parents=True, exist_ok=True)
    with gs.Simulation("linden_flat", seed=0) as sim, (args.folder / "poses.csv").open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["stamp_ns", *(f"T_world_camera_{row}{column}" for row in range(3) for column in range(4))])
        for number in range(args.images):
            sim.command(linear=0.2, angular=0.3)
            sim.step(seconds=0.5)
            frame = sim.render("camera", outputs=["rgb", "depth"])
            millimetres = np.where(np.isfinite(frame.depth), frame.depth * 1000.0, 0.0)  # 0 = no depth, as from depth cameras
            cv2.imwrite(str(args.folder / f"{number:06d}_rgb.png"), frame.rgb[..., ::-1])
            cv2.imwrite(str(args.folder / f"{number:06d}_depth.png"), np.clip(millimetres, 0, 65535).astype(np.uint16))
            table.writerow([frame.stamp_ns, *frame.T_world_camera[:3].ravel()])
    print(f"{args.images} images of {sim.time:.1f} s in {args.folder}")


if __name__ == "__main__":
    main()
