"""Where cameras are: pure geometry, no drawing."""

from __future__ import annotations

from gibson_sim.errors import ConfigError
from gibson_sim.geometry.transforms import Mat4, matrices_from_poses, matrix_from_pose
from gibson_sim.types import CameraSpec, SceneState


def camera_matrix(state: SceneState, camera: CameraSpec) -> Mat4:
    """Returns T_world_camera, (4, 4), optical frame, of a camera at the tick of ``state``; an empty link means the world.

    Raises:
        ConfigError: the camera's link is not in the state.
    """
    T_link_camera = matrix_from_pose(camera.pose)
    if not camera.link:
        return T_link_camera
    if camera.link not in state.links:
        known = ", ".join(state.links) or "none"
        raise ConfigError(f"camera {camera.name!r}: link {camera.link!r} is not in the state; its links: {known}")
    row = state.links.index(camera.link)
    T_world_link: Mat4 = matrices_from_poses(state.positions[row : row + 1], state.quats_xyzw[row : row + 1])[0]
    return T_world_link @ T_link_camera
