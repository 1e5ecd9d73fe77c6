"""The renderer without physics: your own mesh or scene, seen by your own camera. No ROS.

python renderer_alone.py [SCENE] [PICTURE.png]
"""

import argparse
import math

import cv2
import numpy as np

import gibson_sim as gs


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scene", nargs="?", default="linden_flat", help="name, folder, world file, or GLB, OBJ, PLY")
    parser.add_argument("picture", nargs="?", default="renderer_alone.png")
    args = parser.parse_args()
    scene = gs.load_scene(args.scene)
    x, y, z = scene.starts[0].pose.position if scene.starts else (0.0, 0.0, scene.floor_z)
    pose = gs.camera_pose((x, y, z + 1.5), look_at=(x + 1.0, y - 2.0, z + 1.0))  # above the first start pose; z up
    outputs = ("rgb", "depth", "normal", "semantic")
    camera = gs.CameraSpec("eye", "map", pose, width=800, height=600, fov_y=math.radians(60), outputs=outputs)
    with gs.Renderer(scene) as renderer:
        (frame,) = renderer.render(gs.SceneState.still(), [camera])
    cv2.imwrite(args.picture, frame.rgb[..., ::-1])
    seen = frame.depth[np.isfinite(frame.depth)]
    print(f"{args.picture}: {seen.min():.2f} to {seen.max():.2f} m away, {len(np.unique(frame.semantic))} classes")


if __name__ == "__main__":
    main()
