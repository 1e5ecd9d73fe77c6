"""Fills the holes of images: what a scan does not have is made up from what is around it, or by a network. Knows neither ROS nor OpenGL."""
