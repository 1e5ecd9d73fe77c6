"""Package description, read by colcon (ament_python) and by pip. Version: also in package.xml and gibson_sim_bench/__init__.py."""

from setuptools import find_packages, setup

NAME = "gibson_sim_bench"

setup(
    name=NAME,
    version="0.1.0",
    description="Benchmarks of Gibson Sim: rendering, physics, tasks and ROS",
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
    package_data={NAME: ["py.typed"]},
    python_requires=">=3.10",
    install_requires=[
        "gibson_sim==0.1.0",
        "gibson_sim_tools==0.1.0",
        "gibson_sim_learn==0.1.0",
        "gibson_path_following==0.1.0",
        "numpy",
        "opencv-python-headless",
        "PyYAML",
    ],
    extras_require={"plots": ["matplotlib>=3.8"], "web": ["playwright>=1.50"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + NAME]),
        ("share/" + NAME, ["package.xml"]),
    ],
    zip_safe=False,
    # Sub-commands of `gibson-sim`, loaded when they are typed (gibson_sim/cli/registry.py).
    entry_points={"gibson_sim.commands": ["bench = gibson_sim_bench.cli.bench"]},
)
