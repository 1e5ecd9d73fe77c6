"""Relays topics, services and parameters of a ROS domain to the Foxglove server."""
