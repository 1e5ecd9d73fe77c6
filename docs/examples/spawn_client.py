"""Spawns a bottle in front of the robot of a running simulation, with the standard service. Plain ROS 2.

In one terminal: gibson-sim run. In another, after `source env.sh`: python spawn_client.py [NAME] [X] [Y]
"""

import sys

import rclpy
from geometry_msgs.msg import PoseStamped
from simulation_interfaces.srv import SpawnEntity


def main() -> int:
    name, x, y = (*sys.argv[1:4], *("bottle_water", "4.2", "5.7")[len(sys.argv) - 1 :])
    rclpy.init()
    node = rclpy.create_node("spawn_client")
    client = node.create_client(SpawnEntity, "spawn_entity")
    if not client.wait_for_service(timeout_sec=10.0):
        print("no simulation answers: start one with `gibson-sim run`", file=sys.stderr)
        return 1
    request = SpawnEntity.Request(name=name, allow_renaming=True)
    request.uri = name  # one of our objects, or file:///..., package://...
    request.initial_pose = PoseStamped()
    request.initial_pose.header.frame_id = "map"
    request.initial_pose.pose.position.x, request.initial_pose.pose.position.y = float(x), float(y)
    future = client.call_async(request)
    rclpy.spin_until_future_complete(node, future)
    answer = future.result()
    ok = answer.result.result == answer.result.RESULT_OK
    print(f"spawned {answer.entity_name}" if ok else f"refused: {answer.result.error_message}")
    node.destroy_node()
    rclpy.shutdown()
    return 0 if ok else 1


if __name__ == "__main__":
    sys.exit(main())
