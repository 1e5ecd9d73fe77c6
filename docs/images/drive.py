"""Makes drive.webp, the README's animation: a drive through a flat, from the robot and from behind it.

python docs/images/drive.py [FILE.webp]
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

import gibson_sim as gs
from gibson_sim.maps.placement import furnished_floor_map
from gibson_sim.maps.tour import plan_tour
from gibson_sim.robots.path_tracking import PathFollower

WIDTH, HEIGHT, RATE_HZ = 320, 240, 8
"""Size of each of the four pictures, pixels, and rate of the film."""
SECONDS = 14
FARTHEST = 6.0
"""Depth drawn as black, metres."""


def main() -> None:
    """Writes the film."""
    path = Path(sys.argv[1] if len(sys.argv) > 1 else Path(__file__).with_name("drive.webp"))
    pictures: list[NDArray[np.uint8]] = []
    with gs.Simulation("linden_flat", views="follow", view_size=(WIDTH, HEIGHT)) as sim:
        camera = next(camera for camera in sim.cameras if camera.name == "camera")
        colors = np.random.default_rng(5).integers(60, 256, (256, 3), dtype=np.uint8)
        colors[0] = 0
        small = gs.CameraSpec(
            "small", camera.link, camera.pose, WIDTH, HEIGHT, camera.fov_y, outputs=("rgb", "depth", "semantic"), samples=4
        )
        floor = furnished_floor_map(sim.scene, sim.robot.spec)
        x, y, _ = sim.robot.pose.position
        follower = PathFollower(plan_tour(floor, (x, y), sim.robot.spec.radius, 12.0))
        for _ in range(SECONDS * RATE_HZ):
            for _ in range(sim.world.step_hz // RATE_HZ // 6):
                x, y, _ = sim.robot.pose.position
                linear, angular = follower.command(x, y, sim.robot.yaw)
                sim.command(linear=linear, angular=angular)
                sim.step(steps=6)
            frame = sim.render(small)
            behind = sim.render("view_follow", outputs=["rgb"])
            pictures.append(cv2.cvtColor(_sheet(frame, behind, colors), cv2.COLOR_RGB2BGR))
    animation = cv2.Animation()
    animation.frames, animation.durations = pictures, [1000 // RATE_HZ] * len(pictures)
    cv2.imwriteanimation(str(path), animation, [cv2.IMWRITE_WEBP_QUALITY, 80])
    print(f"{path}: {len(pictures)} pictures, {path.stat().st_size / 1e6:.1f} MB")


def _sheet(frame: gs.Frame, behind: gs.Frame, colors: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Returns colour and the view from behind above depth and labels, (480, 640, 3) uint8 sRGB."""
    near = np.clip(1.0 - frame.depth / FARTHEST, 0.0, 1.0)
    depth = cv2.cvtColor(cv2.applyColorMap((near * 255).astype(np.uint8), cv2.COLORMAP_INFERNO), cv2.COLOR_BGR2RGB)
    labels = colors[frame.semantic % len(colors)]
    return np.vstack([np.hstack([frame.rgb, behind.rgb]), np.hstack([depth, labels])])


if __name__ == "__main__":
    main()
