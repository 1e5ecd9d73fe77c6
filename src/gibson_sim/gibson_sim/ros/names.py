"""Names of topics, relative to each node's namespace."""

from __future__ import annotations

from gibson_sim.types import OUTPUTS

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
    """Returns the topics of a camera by what they carry: each output, and under ``<output>_info`` its camera_info."""
    topics: dict[str, str] = {}
    for output in OUTPUTS:
        folder = camera if output == "rgb" else f"{camera}/{output}"
        topics[output] = f"{folder}/image_raw"
        topics[f"{output}_info"] = f"{folder}/camera_info"
    return topics
