"""Data sets from bags: images, depth, poses and measurements in the formats of other programs.

``read`` finds the cameras of a bag, ``poses`` where they were; ``tum``, ``nerfstudio``, ``png`` and ``lerobot`` write. Must not import rclpy.
"""
