"""The live page: a browser sees and drives a robot. Knows no ROS; ``ros.web`` feeds it."""
