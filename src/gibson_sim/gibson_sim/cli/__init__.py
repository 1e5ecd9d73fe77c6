"""The command line. It starts the nodes as processes and never loads ROS, PyBullet or OpenGL itself."""
