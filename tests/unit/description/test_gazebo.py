"""Gazebo elements in robot descriptions, as manufacturers write them."""

from __future__ import annotations

import xml.etree.ElementTree as ET

from gibson_sim.description.gazebo import GazeboTags, read_gazebo

RAYS = """<gazebo reference="laser"><sensor type="{kind}" name="front"><update_rate>15</update_rate><pose>0.1 0 0.2 0 0 1.5</pose>
<{tag}><scan><horizontal><samples>666.5</samples><min_angle>-1.9</min_angle><max_angle>1.9</max_angle></horizontal>{rings}</scan>
<range><min>0.05</min><max>25.0</max></range></{tag}></sensor></gazebo>"""
RINGS = "<vertical><samples>16</samples><min_angle>-0.26</min_angle><max_angle>0.26</max_angle></vertical>"
CAMERA = """<gazebo reference="eye"><sensor type="{kind}" name="rgb"><update_rate>30</update_rate><camera><horizontal_fov>1.0</horizontal_fov>
<image><width>320</width><height>240</height></image></camera></sensor></gazebo>"""


def read(text: str) -> GazeboTags:
    names = ("base", "laser", "eye", "a/wheel", "l_link", "r_link")
    links = "".join(f'<link name="{name}"/>' for name in names)
    joints = "".join(f'<joint name="{name}" type="continuous"/>' for name in ("l", "r", "fl", "fr"))
    return read_gazebo(ET.fromstring(f'<robot name="r">{links}{joints}{text}</robot>'))


def test_lidars_of_both_generations_of_gazebo() -> None:
    for kind, tag, rings, channels in (("gpu_ray", "ray", "", 0), ("gpu_lidar", "lidar", RINGS, 16)):
        (sensor,) = read(RAYS.format(kind=kind, tag=tag, rings=rings)).sensors
        assert (sensor.name, sensor.link, sensor.kind, sensor.rate_hz) == ("front", "laser", "lidar", 15.0)
        assert (sensor.samples, sensor.angles, sensor.channels) == (666, (-1.9, 1.9), channels)
        assert (sensor.range_min, sensor.range_max) == (0.05, 25.0)
        assert (sensor.xyz, sensor.rpy) == ((0.1, 0.0, 0.2), (0.0, 0.0, 1.5))
    assert sensor.elevations == (-0.26, 0.26)


def test_cameras_and_what_is_not_simulated() -> None:
    for kind, expected in (("camera", "camera"), ("rgbd_camera", "depth_camera"), ("depth", "depth_camera")):
        (sensor,) = read(CAMERA.format(kind=kind)).sensors
        assert (sensor.kind, sensor.width, sensor.height, sensor.fov_x) == (expected, 320, 240, 1.0)
    assert read(CAMERA.format(kind="contact")).sensors == ()
    assert read(CAMERA.format(kind="camera").replace('"eye"', '"not_there"')).sensors == ()


def test_malformed_elements_are_skipped() -> None:
    text = (
        RAYS.format(kind="ray", tag="ray", rings="")
        .replace("666.5", "many")
        .replace("25.0", "inf")
        .replace("<pose>0.1", "<pose>")
    )
    (sensor,) = read(text).sensors
    assert (sensor.samples, sensor.range_max, sensor.xyz) == (0, 0.0, (0.0, 0.0, 0.0))
    assert read('<gazebo reference="base"><mu1>much</mu1></gazebo>').frictions == {}


def test_references_without_the_link_prefix_are_resolved() -> None:
    assert read('<gazebo reference="wheel"><mu1>0.2</mu1><mu2>9</mu2></gazebo>').frictions == {"a/wheel": 0.2}


def test_plugins_that_drive_name_the_wheels() -> None:
    plugin = '<gazebo><plugin filename="{}" name="p">{}</plugin></gazebo>'.format
    classic = plugin(
        "libgazebo_ros_diff_drive.so",
        "<left_joint>l</left_joint><right_joint>r</right_joint><wheel_diameter>0.2</wheel_diameter>",
    )
    old = plugin(
        "libgazebo_ros_diff_drive.so", "<leftJoint>l</leftJoint><rightJoint>r</rightJoint><wheelDiameter>0.2</wheelDiameter>"
    )
    new = plugin(
        "gz-sim-diff-drive-system", "<left_joint>l</left_joint><right_joint>r</right_joint><wheel_radius>0.1</wheel_radius>"
    )
    for text in (classic, old, new):
        drive = read(text).drive
        assert drive is not None
        assert (drive.kind, drive.joints, drive.wheel_radius) == ("differential", ("l", "r"), 0.1)
    wheels = "".join(f"<{n}_joint>{n[0] + n.split('_')[1][0]}</{n}_joint>" for n in ("front_left", "front_right"))
    mecanum = read(plugin("gz-sim-mecanum-drive-system", wheels)).drive
    assert mecanum is not None and (mecanum.kind, mecanum.joints) == ("omni", ("fl", "fr"))
    assert read(plugin("libgazebo_ros_diff_drive.so", "<left_joint>gone</left_joint>")).drive is None
    assert read(plugin("libgazebo_ros2_control.so", "<left_joint>l</left_joint><right_joint>r</right_joint>")).drive is None
