"""The snapshot node: saves one image of each output of each camera of a running simulation."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from sensor_msgs.msg import Image

from gibson_msgs.msg import Scene
from gibson_sim.client_config import SnapshotConfig
from gibson_sim.errors import ConfigError, WriteError
from gibson_sim.picture_files import write_array, write_picture
from gibson_sim.ros import conversions
from gibson_sim.ros.nodes.node_main import run_node, spin_while
from gibson_sim.ros.nodes.params import config_from_parameters
from gibson_sim.ros.nodes.wait_for_simulation import WaitCondition
from gibson_sim.ros.topics import names, qos

_ARRAYS = ("position", "flow")
"""Outputs that are saved as NumPy arrays, since PNG cannot store them."""


class SnapshotNode(Node):
    """Waits for the scene, saves the next image of every camera, and ends.

    ``<camera>_rgb.png`` is 8-bit colour; ``<camera>_depth.png`` is 16-bit, millimetres, 0 = nothing or beyond 65.5 m (REP 118);
    ``<camera>_semantic.png`` and ``_instance.png`` are 16-bit labels, whose names are in /scene; ``_hole.png`` has 8-bit labels;
    ``_normal.png`` and ``_normal_world.png`` map x, y, z from -1..1 to red, green, blue from 0..255; ``_position.npy`` and
    ``_flow.npy`` are NumPy arrays. Camera ``left/camera`` is ``left_camera`` in file names.

    Parameters: the fields of ``gibson_sim.client_config.SnapshotConfig``.
    """

    def __init__(self, **kwargs: Any) -> None:
        """Creates the folder and subscribes to the scene. ``kwargs`` go to ``rclpy.node.Node``.

        Raises:
            ConfigError: the folder cannot be created.
        """
        super().__init__("snapshot", **kwargs)
        self._config = config_from_parameters(self, SnapshotConfig)
        self._folder = Path(self._config.output)
        self._created = [folder for folder in (self._folder, *self._folder.parents) if not folder.exists()]
        """Folders that this node creates, innermost first."""
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ConfigError(
                f"folder {self._folder} cannot be used: {error.strerror}; choose one that can be written"
            ) from error
        self._missing: dict[str, str] = {}
        """Topic -> file name of each image that has not arrived."""
        self._scene_seen = False
        self._failed: WriteError | None = None
        self.create_subscription(Scene, names.SCENE, self._on_scene, qos.LATCHED)

    def _on_scene(self, msg: Scene) -> None:
        if self._scene_seen:
            return
        self._scene_seen = True
        for camera in conversions.scene_from_msg(msg).cameras:
            for kind in camera.outputs:
                topic = names.camera_topics(camera.name)[kind]
                file = f"{camera.name.replace('/', '_')}_{kind}"
                self._missing[topic] = f"{file}.{'npy' if kind in _ARRAYS else 'png'}"
                self.create_subscription(Image, topic, partial(self._on_image, topic), qos.SENSOR)

    def _on_image(self, topic: str, msg: Image) -> None:
        name = self._missing.pop(topic, None)
        if name is None:
            return
        path = self._folder / name
        pixels = conversions.array_from_image(msg)
        try:
            if path.suffix == ".npy":
                write_array(path, pixels)
            else:
                write_picture(path, png_pixels(pixels))
        except WriteError as error:  # rclpy would print a traceback of an exception in a callback
            self._failed = error
            return
        print(f"{path} (16-bit, millimetres: dark in image viewers)" if path.stem.endswith("_depth") else path)

    def spin(self) -> int:
        """Spins until every image is saved; returns the exit code.

        Raises:
            GibsonSimError: no simulation is discovered within ``timeout``, an image does not arrive within ``timeout`` after that, or an image
                cannot be written.
        """
        timeout_s = self._config.timeout
        simulation = WaitCondition.for_simulation(self, names.SCENE, timeout_s)
        spin_while(self, lambda: not (simulation.is_met() and self._scene_seen))
        images = WaitCondition(self, self._missing_images, lambda: not self._is_waiting, timeout_s=timeout_s)
        spin_while(self, lambda: self._failed is None and not images.is_met())
        if self._failed is not None:
            raise self._failed
        return 1 if self._is_waiting else 0

    def _missing_images(self) -> str:
        return f"an image on {', '.join(self._missing)}"

    @property
    def _is_waiting(self) -> bool:
        return bool(self._missing) or not self._scene_seen

    def close(self) -> None:
        """Removes the folders that this node created if they are empty."""
        remove_empty(self._created)


def remove_empty(folders: Iterable[Path]) -> None:
    """Removes folders, innermost first, up to the first one that is not empty."""
    for folder in folders:
        try:
            folder.rmdir()
        except OSError:
            return


def png_pixels(pixels: NDArray[Any]) -> NDArray[Any]:
    """Returns the pixels of a PNG: BGR uint8 for colours and normals, uint16 for labels and for depth in mm, uint8 for holes."""
    if pixels.dtype == np.uint16 or (pixels.dtype == np.uint8 and pixels.ndim == 2):
        return pixels
    if pixels.ndim == 3:
        colors = pixels if pixels.dtype == np.uint8 else np.rint(127.5 * (pixels + 1.0)).astype(np.uint8)
        return np.ascontiguousarray(colors[:, :, ::-1])
    millimetres = np.nan_to_num(pixels * 1000.0, nan=0.0, posinf=0.0, neginf=0.0).round()
    millimetres[(millimetres < 0) | (millimetres > 65535)] = 0
    return millimetres.astype(np.uint16)


def main(args: list[str] | None = None) -> None:
    """Runs the snapshot node."""
    run_node(SnapshotNode, args)


if __name__ == "__main__":
    main()
