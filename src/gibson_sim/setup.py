"""Package description, read by colcon (ament_python) and by pip. Version: also in package.xml and gibson_sim/__init__.py."""

import os
from glob import glob

from setuptools import find_packages, setup

NAME = "gibson_sim"


def share(folder):
    """Returns data_files entries for everything below a folder, links followed, under share/gibson_sim/<folder>."""
    entries = []
    for place, folders, names in os.walk(folder, followlinks=True):
        folders[:] = sorted(name for name in folders if name != "__pycache__" and not name.startswith("."))
        files = sorted(os.path.join(place, name) for name in names if not name.startswith("."))
        if files:
            entries.append((os.path.join("share", NAME, place), files))
    return entries


setup(
    name=NAME,
    version="0.1.0",
    description="A ROS 2 simulation server for indoor robots: PyBullet physics, EGL rendering",
    license="Apache-2.0",
    author="Gibson Sim maintainers",
    maintainer="Gibson Sim maintainers",
    maintainer_email="maintainers@gibson-sim.example",
    classifiers=[
        "Development Status :: 4 - Beta",
        "Intended Audience :: Developers",
        "Intended Audience :: Science/Research",
        "License :: OSI Approved :: Apache Software License",
        "Operating System :: POSIX :: Linux",
        "Programming Language :: Python :: 3.10",
        "Programming Language :: Python :: 3.11",
        "Programming Language :: Python :: 3.12",
        "Programming Language :: Python :: 3.13",
        "Programming Language :: Python :: Implementation :: CPython",
        "Topic :: Scientific/Engineering",
    ],
    packages=find_packages(include=[NAME, NAME + ".*"]),
    package_data={NAME: ["py.typed", "render/shaders/*", "web/page/*", "filling/models/*"]},
    python_requires=">=3.10",
    install_requires=[
        "numpy",
        "scipy",
        "opencv-python-headless",
        "moderngl",
        "Pillow",
        "PyYAML",
        # The same module: PyBullet itself has wheels up to Python 3.11.
        "pybullet; python_version < '3.12'",
        "pybullet-arm64>=3.2.8; python_version >= '3.12'",
        "rosbags",
        "ruamel-yaml",
        "mcap",
        "lz4",
        "mapbox-earcut",
        "DracoPy",
        "zstandard",
        "av",
        "rich",
        "argcomplete",
        "aiohttp",
        "xacro",
    ],
    extras_require={
        "test": ["pytest", "pytest-rerunfailures", "pytest-xdist", "hypothesis"],
        "cuda": ["cuda-bindings>=12.6"],
        "torch": ["torch>=2.3"],
        "lerobot": ["pyarrow>=15"],
        "fast": ["numba>=0.61"],
        "gym": ["gymnasium>=1.1"],
        "learn": ["gymnasium>=1.1", "stable-baselines3>=2.6", "torch>=2.3", "matplotlib>=3.8"],
        "analysis": ["matplotlib>=3.8"],
        "foxglove": ["foxglove-sdk>=0.30"],
        "mcp": ["mcp>=2.3"],
        "ray": ["ray>=2.40"],
        "filler": ["onnxruntime>=1.20"],
        # Levels of detail, compressed glTF, simplified scans. Has no wheels: pip compiles it.
        "meshes": ["meshoptimizer>=0.2.30a0"],
        # The nodes, on the ROS packages of PyPI; a ROS installation has all of them. Both lists: docs/install_pip.md.
        "ros": [
            "ros-jazzy-rclpy[fastrtps]~=7.1.6",
            "ros-jazzy-common-interfaces~=5.3.6",
            "gibson_msgs==0.1.0",
            "gibson_sim_control_msgs==0.1.0",
            "gibson_sim_rosbag2_interfaces==0.1.0",
            "gibson_sim_simulation_interfaces==0.1.0",
            "gibson_sim_tf2_msgs==0.1.0",
        ],
        "scenes": ["gibson_sim_scenes==0.1.0"],
    },
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + NAME]),
        ("share/" + NAME, ["package.xml"]),
        ("share/" + NAME + "/launch", sorted(glob("launch/*.launch.py"))),
        *share("config"),
        *share("scenes"),
    ],
    zip_safe=False,
    entry_points={
        "pytest11": ["gibson_sim.pytest = gibson_sim.pytest"],
        "console_scripts": [
            "gibson-sim = gibson_sim.cli.main:main",
            "physics_node = gibson_sim.ros.nodes.start:physics_node",
            "render_node = gibson_sim.ros.nodes.start:render_node",
            "drive_node = gibson_sim.ros.nodes.start:drive_node",
            "record_node = gibson_sim.ros.nodes.start:record_node",
            "snapshot_node = gibson_sim.ros.nodes.start:snapshot_node",
            "replay_node = gibson_sim.ros.nodes.start:replay_node",
            "task_node = gibson_sim.ros.nodes.start:task_node",
            "web_node = gibson_sim.ros.nodes.start:web_node",
            "foxglove_node = gibson_sim.ros.nodes.start:foxglove_node",
        ],
    },
)
