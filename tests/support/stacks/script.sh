#!/bin/sh
# A stack of any ROS clients: waits for the goal, whatever it is, and drives 0.8 m ahead.
gibson-sim topic echo goal_pose --once > /dev/null && exec gibson-sim drive forward --length 0.8 --linear 0.2
