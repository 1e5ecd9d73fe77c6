"""What the Foxglove server has of ROS: topics, services and parameters."""
