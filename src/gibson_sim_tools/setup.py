"""Package description, read by colcon (ament_python) and by pip. Version: also in package.xml and gibson_sim_tools/__init__.py."""

from setuptools import find_packages, setup

NAME = "gibson_sim_tools"

setup(
    name=NAME,
    version="0.1.0",
    description="Makes, imports, checks and scans scenes for Gibson Sim",
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
    install_requires=["gibson_sim==0.1.0", "numpy", "scipy", "opencv-python-headless", "PyYAML", "rich", "trimesh"],
    extras_require={
        "authoring": ["bpy"],
        "collision": ["coacd>=1.0.7"],
        "usd": ["usd-core>=24.8"],
        "scanning": ["open3d-cpu>=0.19; platform_machine == 'x86_64'", "open3d>=0.19; platform_machine != 'x86_64'"],
    },
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + NAME]),
        ("share/" + NAME, ["package.xml"]),
    ],
    zip_safe=False,
    # Sub-commands of `gibson-sim`, loaded when they are typed (gibson_sim/cli/registry.py).
    entry_points={
        "gibson_sim.tracers": ["cycles = gibson_sim_tools.tracing.bags:CyclesColors"],
        "gibson_sim.scene_commands": [
            "check = gibson_sim_tools.cli.inspect",
            "collision = gibson_sim_tools.cli.collision",
            "fetch = gibson_sim_tools.cli.fetch",
            "fuse = gibson_sim_tools.cli.scan",
            "generate = gibson_sim_tools.cli.generate",
            "import = gibson_sim_tools.cli.importing",
            "inspect = gibson_sim_tools.cli.inspect",
            "objects = gibson_sim_tools.cli.objects",
            "robot = gibson_sim_tools.cli.robot",
            "scan = gibson_sim_tools.cli.scan",
            "texture = gibson_sim_tools.cli.texture",
            "view = gibson_sim_tools.cli.view",
        ],
    },
)
