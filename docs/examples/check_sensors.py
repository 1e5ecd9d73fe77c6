"""Compares a recorded drive with the scene that it was driven in: depth images with the mesh, lidar with the map of the bag. No ROS.

python check_sensors.py BAG SCENE [--images 20]

Depth is compared with a CPU rasterisation of the mesh, independent of the renderer, at the true poses of the camera; lidar points with the
occupied cells of the map, 0 within a cell. Needs gibson_sim_tools.
"""

from __future__ import annotations

import argparse

import numpy as np
from scipy.spatial import cKDTree

import gibson_sim as gs
from gibson_sim.bags.reader import BagReader, image_to_array
from gibson_sim.geometry.transforms import matrix_from_pose
from gibson_sim.types import Pose
from gibson_sim_tools.scanning.clean_scene import opaque_triangles
from gibson_sim_tools.scanning.posed_images import Intrinsics
from gibson_sim_tools.texturing.rasteriser import rasterise
from gibson_sim_tools.texturing.surface import Surface, split_long_edges

DEPTH, SCAN, ODOMETRY = "/camera/depth/image_raw", "/scan", "/ground_truth/odom"


def matrix(at, turn) -> np.ndarray:
    return matrix_from_pose(Pose((at.x, at.y, at.z), (turn.x, turn.y, turn.z, turn.w)))


def stamp(msg) -> int:
    return msg.header.stamp.sec * 10**9 + msg.header.stamp.nanosec


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("bag")
    parser.add_argument("scene")
    parser.add_argument("--images", type=int, default=20)
    args = parser.parse_args()
    vertices, triangles = opaque_triangles(gs.load_scene(args.scene))
    # Small triangles: the rasteriser drops those that reach behind the camera.
    surface = split_long_edges(Surface(vertices, triangles.astype(np.int64)), 0.1)
    with BagReader(args.bag) as bag:
        static = {}
        for _, _, msg in bag.messages(["/tf_static"]):
            for t in msg.transforms:
                static[t.child_frame_id] = (t.header.frame_id, matrix(t.transform.translation, t.transform.rotation))
        poses, way, last = {}, 0.0, None
        for _, _, msg in bag.messages([ODOMETRY]):
            poses[stamp(msg)] = T = matrix(msg.pose.pose.position, msg.pose.pose.orientation)
            base = msg.child_frame_id
            way += 0.0 if last is None else float(np.linalg.norm(T[:3, 3] - last))
            last = T[:3, 3]

        def pose(msg) -> np.ndarray:
            T, frame = np.eye(4), msg.header.frame_id
            while frame != base:
                frame, T_parent = static[frame][0], static[frame][1]
                T = T_parent @ T
            return poses[stamp(msg)] @ T

        info = bag.first("/camera/camera_info")
        lens = Intrinsics(info.width, info.height, info.k[0], info.k[4], info.k[2], info.k[5])
        count = bag.topics()[DEPTH].count
        chosen = set(np.linspace(0, count - 1, args.images).round().astype(int).tolist())
        depths = []
        for number, (_, _, msg) in enumerate(bag.messages([DEPTH])):
            if number in chosen and stamp(msg) in poses:
                measured, rasterised = image_to_array(msg), rasterise(surface, lens, pose(msg)).depth
                both = np.isfinite(measured) & np.isfinite(rasterised)
                depths.append(np.abs(measured[both] - rasterised[both]))
        chart = bag.first("/map")
        cell, at = chart.info.resolution, chart.info.origin.position
        rows, columns = np.nonzero(np.asarray(chart.data).reshape(chart.info.height, chart.info.width) == 100)
        centres = np.stack([columns, rows], axis=1) * cell + (at.x + cell / 2, at.y + cell / 2)
        tree, points = cKDTree(centres), []
        for _, _, msg in bag.messages([SCAN]):
            ranges = np.asarray(msg.ranges)
            hit = np.isfinite(ranges) & (ranges < msg.range_max)
            angle = msg.angle_min + msg.angle_increment * np.flatnonzero(hit)
            flat = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1) * ranges[hit, None]
            T = pose(msg) if stamp(msg) in poses else None
            if T is not None:
                points.append((flat @ T[:3, :3].T + T[:3, 3])[:, :2])
    world = np.concatenate(points)
    near = tree.query(world, k=4)[1]
    outside = np.linalg.norm(np.maximum(np.abs(world[:, None] - centres[near]) - cell / 2, 0.0), axis=2).min(axis=1)
    print(f"driven: {way:.1f} m")
    for name, found, limit in (("depth against mesh", np.concatenate(depths), 0.01), ("lidar against map", outside, 0.03)):
        print(
            f"{name}: median {1000 * np.median(found):.1f} mm, 95 % below {1000 * np.percentile(found, 95):.1f} mm; "
            f"{100 * np.mean(found > limit):.2f} % of {len(found)} beyond {100 * limit:g} cm"
        )


if __name__ == "__main__":
    main()
