"""Fills holes in images of scans, from the surrounding pixels or with a network. Imports neither ROS nor OpenGL."""
