"""The live page: shows and drives a robot in a browser. Must not import ROS; ``ros.web`` provides the data."""
