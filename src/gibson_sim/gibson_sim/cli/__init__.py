"""The command line. It starts nodes in processes of their own; the launcher never loads ROS, PyBullet or OpenGL."""
