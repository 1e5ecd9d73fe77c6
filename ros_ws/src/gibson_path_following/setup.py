"""Package description, read by colcon (ament_python) and by pip. Version: also in package.xml and gibson_path_following/__init__.py."""

from glob import glob

from setuptools import find_packages, setup

NAME = "gibson_path_following"

setup(
    name=NAME,
    version="0.1.0",
    description="Follows a recorded path by camera images alone, on a robot or in simulation",
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
    package_data={NAME: ["py.typed", "models/*"]},
    python_requires=">=3.10",
    install_requires=["numpy", "opencv-python-headless", "PyYAML"],
    extras_require={"onnx": ["onnxruntime>=1.20"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + NAME]),
        ("share/" + NAME, ["package.xml"]),
        ("share/" + NAME + "/config", sorted(glob("config/*.yaml"))),
        ("share/" + NAME + "/launch", sorted(glob("launch/*.launch.py"))),
    ],
    zip_safe=False,
    entry_points={
        "console_scripts": [
            f"{name} = {NAME}.nodes.start:{name}"
            for name in ("path_recorder", "path_localiser", "path_policy", "path_evaluator", "camera_faults", "goggles")
        ]
    },
)
