"""Bags: writes, repairs, reads, checks, compares and exports rosbag2 folders.

Knows CDR bytes and message definitions, but neither rclpy nor any message package: the nodes that subscribe are in ``gibson_sim.ros``.
"""
