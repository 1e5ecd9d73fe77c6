"""Package description, read by colcon (ament_python) and by pip. Version: also in package.xml and gibson_examples/__init__.py."""

from glob import glob

from setuptools import find_packages, setup

NAME = "gibson_examples"

setup(
    name=NAME,
    version="0.1.0",
    description="A small navigation stack on standard ROS 2 topics alone, to show that Gibson Sim feeds one",
    license="Apache-2.0",
    author="Gibson Sim maintainers",
    maintainer="Gibson Sim maintainers",
    maintainer_email="maintainers@gibson-sim.example",
    packages=find_packages(include=[NAME, NAME + ".*"]),
    package_data={NAME: ["py.typed"]},
    python_requires=">=3.10",
    install_requires=["numpy", "scipy"],
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + NAME]),
        ("share/" + NAME, ["package.xml"]),
        ("share/" + NAME + "/config", sorted(glob("config/*.yaml"))),
        ("share/" + NAME + "/launch", sorted(glob("launch/*.launch.py"))),
    ],
    zip_safe=False,
    entry_points={
        "console_scripts": [
            "navigate = gibson_examples.navigate:main",
            "navigation_trial = gibson_examples.trial:main",
            "named_goals = gibson_examples.named_goals:main",
        ]
    },
)
