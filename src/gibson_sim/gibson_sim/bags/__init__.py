"""Bags: recording to rosbag2 folders, mending, reading, checking and picturing them.

Knows CDR bytes and message definitions, but neither rclpy nor any message package: what subscribes lives in ``gibson_sim.ros``.
"""
