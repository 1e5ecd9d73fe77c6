"""Names of topics, relative to each node's namespace."""

from __future__ import annotations

CLOCK = "/clock"
TF = "/tf"
TF_STATIC = "/tf_static"
CMD_VEL = "cmd_vel"
ODOM = "odom"
GROUND_TRUTH = "ground_truth/odom"
JOINT_STATES = "joint_states"
SCAN = "scan"
ROBOT_DESCRIPTION = "robot_description"
SCENE = "scene"
SCENE_STATE = "scene_state"
DIAGNOSTICS = "/diagnostics"

ODOM_FRAME = "odom"


def camera_topics(camera: str) -> dict[str, str]:
    """Returns the topics of a camera by what they carry."""
    return {
        "rgb": f"{camera}/image_raw",
        "rgb_info": f"{camera}/camera_info",
        "depth": f"{camera}/depth/image_raw",
        "depth_info": f"{camera}/depth/camera_info",
    }
