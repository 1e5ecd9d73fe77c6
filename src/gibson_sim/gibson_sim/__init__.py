"""Gibson Sim: a ROS 2 simulation server for indoor robots (PyBullet physics, EGL rendering).

Importing this package executes nothing and loads neither ROS, PyBullet, OpenGL nor torch.
"""

__version__ = "0.1.0"
