"""The ROS side of the live page: subscriptions to topics that it shows, and clients of services that it calls."""
