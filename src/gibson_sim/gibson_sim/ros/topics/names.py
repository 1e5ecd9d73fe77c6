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
TIME_CONTROL = "time_control"
RUN_INFO = "run_info"

ODOM_FRAME = "odom"


def participant(namespace: str, node: str) -> str:
    """Returns the name of a node in lockstep: its full name without the leading slash."""
    return f"{namespace.strip('/')}/{node}".lstrip("/")


def link_name(name: str) -> str:
    """Returns the link name, which is the tf frame without prefix, of ``<body>/<link>``."""
    return name.rpartition("/")[2]


def controller(name: str, interface: str) -> str:
    """Returns the name of a topic or an action of the controller of an arm or a gripper."""
    return f"{name}_controller/{interface}"


def servo(arm: str) -> str:
    """Returns the topic of velocity commands for an arm's tool."""
    return f"{arm}_servo/delta_twist_cmds"


def floor_map(number: int) -> str:
    """Returns the topic of a floor's map, 0 = the lowest."""
    return f"floor_{number}/{MAP}"


def bumper_wrench(bumper: str) -> str:
    """Returns the topic of the force on a bumper."""
    return f"{bumper}/wrench"


def camera_topics(camera: str) -> dict[str, str]:
    """Returns kind -> topic of a camera; the kinds are the outputs, and ``<output>_info`` for the camera_info of each."""
    topics: dict[str, str] = {}
    for output in OUTPUTS:
        folder = camera if output == "rgb" else f"{camera}/{output}"
        topics[output] = f"{folder}/image_raw"
        topics[f"{output}_info"] = f"{folder}/camera_info"
    return topics


def image_topics(camera: str, outputs: Iterable[Output]) -> tuple[str, ...]:
    """Returns all topics on which a camera with these outputs may publish raw and compressed images and point clouds."""
    raw_topics, outputs = camera_topics(camera), tuple(outputs)
    topics = [raw_topics[output] for output in outputs]
    if "rgb" in outputs:
        topics.append(compressed_topic(raw_topics["rgb"]))
    if "depth" in outputs:
        topics += [compressed_depth_topic(raw_topics["depth"]), points_topic(camera), registered_depth_topics(camera)[0]]
    return tuple(topics)


def compressed_topic(topic: str) -> str:
    """Returns the image_transport topic for the JPEG or PNG images of an image topic."""
    return f"{topic}/compressed"


def compressed_depth_topic(topic: str) -> str:
    """Returns the image_transport topic for the compressed images of a depth image topic."""
    return f"{topic}/compressedDepth"


def points_topic(camera: str) -> str:
    """Returns the topic of the point cloud of a depth camera."""
    return f"{camera}/depth/points"


def is_hidden(topic: str) -> bool:
    """Returns whether ROS tools hide a topic by default, such as those of actions: a token of its name begins with ``_``."""
    return "/_" in topic


def is_derived(topic: str) -> bool:
    """Returns whether a topic has the data of another topic of the same camera in another format."""
    return topic.endswith(
        ("/compressed", "/compressedDepth", "/depth/points", "/depth_registered/image_raw", "/depth_registered/camera_info")
    )


def label_info_topic(camera: str, output: str) -> str:
    """Returns the latched topic with the label names of a label output."""
    return f"{camera}/{output}/label_info"


def registered_depth_topics(camera: str) -> tuple[str, str]:
    """Returns the topics of a camera's registered depth image, and of its camera_info, which is that of the target camera."""
    folder = f"{camera}/depth_registered"
    return f"{folder}/image_raw", f"{folder}/camera_info"
