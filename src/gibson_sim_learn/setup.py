"""Package description, read by colcon (ament_python) and by pip. Version: also in package.xml and gibson_sim_learn/__init__.py."""

from setuptools import find_packages, setup

NAME = "gibson_sim_learn"

setup(
    name=NAME,
    version="0.1.0",
    description="Networks for robots, trained in Gibson Sim",
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
    package_data={NAME: ["py.typed", "path_following/*.yaml"]},
    python_requires=">=3.10",
    install_requires=["gibson_sim==0.1.0", "gibson_path_following==0.1.0", "numpy", "opencv-python-headless", "scipy"],
    extras_require={"learn": ["matplotlib>=3.8", "onnx>=1.17", "onnxruntime>=1.20", "torch>=2.3"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + NAME]),
        ("share/" + NAME, ["package.xml"]),
    ],
    zip_safe=False,
    entry_points={"gibson_sim.commands": ["learn = gibson_sim_learn.cli.learn"]},
)
