"""Names of topics, relative to each node's namespace."""

from __future__ import annotations

from collections.abc import Iterable

from gibson_sim.types import OUTPUTS, Output

CLOCK = "/clock"
TF = "/tf"
TF_STATIC = "/tf_static"
CMD_VEL = "cmd_vel"
CMD_VEL_APPLIED = "cmd_vel_applied"
JOINT_TRAJECTORY = "joint_trajectory"
JOINT_COMMAND = "joint_command"
OBJECT_JOINT_STATES = "object_joint_states"
OBJECT_JOINT_COMMAND = "object_joint_command"
GRASP = "grasp"
GRASP_STATE = "grasp_state"
CONTACTS = "contacts"
COLLISIONS = "collisions"
ODOM = "odom"
GROUND_TRUTH = "ground_truth/odom"
JOINT_STATES = "joint_states"
SCAN = "scan"
ROBOT_DESCRIPTION = "robot_description"
SCENE = "scene"
SCENE_STATE = "scene_state"
DIAGNOSTICS = "/diagnostics"
MAP = "map"
EPOCH = "simulation_epoch"
REAL_TIME_FACTOR = "real_time_factor"
TICK_DONE = "tick_done"
TICK_DIGEST = "tick_digest"
INPUTS = "inputs"
INPUTS_AT = "inputs_at"
RUN_INFO = "run_info"

ODOM_FRAME = "odom"


def link_name(name: str) -> str:
    """Returns the tf frame of ``<body>/<link>``, without a prefix."""
    return name.rpartition("/")[2]


def controller(name: str, what: str) -> str:
    """Returns a topic or an action of the controller of an arm or a gripper."""
    return f"{name}_controller/{what}"


def servo(arm: str) -> str:
    """Returns the topic of the velocities of an arm's tool."""
    return f"{arm}_servo/delta_twist_cmds"


def floor_map(number: int) -> str:
    """Returns the topic of a floor's map, 0 = the lowest."""
    return f"floor_{number}/{MAP}"


def bumper_wrench(bumper: str) -> str:
    """Returns the topic of the force on a bumper."""
    return f"{bumper}/wrench"


def camera_topics(camera: str) -> dict[str, str]:
    """Returns the topics of a camera by what they carry: each output, and under ``<output>_info`` its camera_info."""
    topics: dict[str, str] = {}
    for output in OUTPUTS:
        folder = camera if output == "rgb" else f"{camera}/{output}"
        topics[output] = f"{folder}/image_raw"
        topics[f"{output}_info"] = f"{folder}/camera_info"
    return topics


def image_topics(camera: str, outputs: Iterable[Output]) -> tuple[str, ...]:
    """Returns all topics on which a camera with these outputs may publish images, compressed ones and point clouds."""
    topics, outputs = camera_topics(camera), tuple(outputs)
    found = [topics[output] for output in outputs]
    if "rgb" in outputs:
        found.append(compressed_topic(topics["rgb"]))
    if "depth" in outputs:
        found += [compressed_depth_topic(topics["depth"]), points_topic(camera), registered_depth_topics(camera)[0]]
    return tuple(found)


def compressed_topic(topic: str) -> str:
    """Returns the image_transport topic for the JPEG or PNG of an image topic."""
    return f"{topic}/compressed"


def compressed_depth_topic(topic: str) -> str:
    """Returns the image_transport topic for the compressed form of a depth image topic."""
    return f"{topic}/compressedDepth"


def points_topic(camera: str) -> str:
    """Returns the topic of the point cloud of a camera's depth."""
    return f"{camera}/depth/points"


def is_hidden(topic: str) -> bool:
    """Returns whether ROS tools hide a topic by default, such as those of actions: a part of its name begins with ``_``."""
    return "/_" in topic


def is_derived(topic: str) -> bool:
    """Returns whether a topic has the same data as another topic of the same camera, in another form."""
    return topic.endswith(
        ("/compressed", "/compressedDepth", "/depth/points", "/depth_registered/image_raw", "/depth_registered/camera_info")
    )


def label_info_topic(camera: str, output: str) -> str:
    """Returns the latched topic that names the numbers of a label output."""
    return f"{camera}/{output}/label_info"


def registered_depth_topics(camera: str) -> tuple[str, str]:
    """Returns the topics of a camera's depth registered to another camera, and of that camera's camera_info."""
    folder = f"{camera}/depth_registered"
    return f"{folder}/image_raw", f"{folder}/camera_info"
