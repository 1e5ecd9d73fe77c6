"""What the live page shows of ROS topics, and the services that it asks."""
