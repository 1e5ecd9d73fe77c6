"""Data sets from bags: images, depths, poses and measurements in the formats of other programs.

``read`` says what a bag has, ``poses`` where its cameras were; ``tum``, ``nerfstudio``, ``png`` and ``lerobot`` write. Must not import rclpy.
"""
