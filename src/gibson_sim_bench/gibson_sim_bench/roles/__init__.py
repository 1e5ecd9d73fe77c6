"""Nodes of the benchmarks, each in a process of its own; alone in this package, they import ROS."""
