"""Converts commands of arms, grasp states, contacts and collision counts."""

from __future__ import annotations

from collections.abc import Iterable

from geometry_msgs.msg import Point, TwistStamped

from gibson_msgs.msg import CollisionCount as RosCollisionCount, Contact as RosContact, Contacts, GraspState as RosGraspState
from gibson_sim.robots.collision_count import CollisionCount
from gibson_sim.robots.joints.grasping import GraspState
from gibson_sim.robots.joints.servo import ToolTwist
from gibson_sim.ros.conversions.basics import header_to_msg, vector_from_msg, vector_to_msg
from gibson_sim.types import WORLD_FRAME, Contact


def tool_twist_from_msg(msg: TwistStamped, frame_prefix: str = "") -> ToolTwist:
    """Returns the commanded velocity of a tool.

    Args:
        msg: message whose frame is a link of the robot; empty = the base.
        frame_prefix: prefix of the robot's frame names.

    Raises:
        CommandError: a number is NaN or infinite.
    """
    frame = msg.header.frame_id.removeprefix(frame_prefix)
    return ToolTwist(vector_from_msg(msg.twist.linear), vector_from_msg(msg.twist.angular), frame)


def grasp_state_to_msg(state: GraspState, stamp_ns: int) -> RosGraspState:
    """Returns the grasp state of a gripper as a message."""
    msg = RosGraspState(header=header_to_msg(stamp_ns, ""), arm=state.arm, mode=state.mode, holding=state.holding)
    msg.body, msg.link, msg.reason = state.body, state.link, state.reason
    msg.force, msg.torque = state.force, state.torque
    return msg


def contacts_to_msg(contacts: Iterable[Contact], stamp_ns: int) -> Contacts:
    """Returns contact points as a message."""
    return Contacts(header=header_to_msg(stamp_ns, WORLD_FRAME), contacts=[_contact_to_msg(contact) for contact in contacts])


def _contact_to_msg(contact: Contact) -> RosContact:
    x, y, z = contact.position
    return RosContact(
        body_a=contact.body_a,
        link_a=contact.link_a,
        body_b=contact.body_b,
        link_b=contact.link_b,
        position=Point(x=x, y=y, z=z),
        normal=vector_to_msg(contact.normal),
        force=contact.force,
        distance=contact.distance,
    )


def collision_count_to_msg(count: CollisionCount, stamp_ns: int) -> RosCollisionCount:
    """Returns the collision count of a robot as a message."""
    msg = RosCollisionCount(header=header_to_msg(stamp_ns, ""), count=count.count, ongoing=count.ongoing)
    msg.duration, msg.greatest_force = count.duration, count.greatest_force
    msg.last_link, msg.last_body = count.last_link, count.last_body
    return msg
