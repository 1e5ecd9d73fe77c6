"""The command line. It starts nodes in separate processes; the launcher never imports ROS, PyBullet or OpenGL."""
