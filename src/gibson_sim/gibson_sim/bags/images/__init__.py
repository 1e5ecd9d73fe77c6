"""Images in bags, raw and compressed as image_transport does it. Must not import rclpy."""
