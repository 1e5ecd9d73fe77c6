"""What touches what, for whoever wants to know."""

from __future__ import annotations

from rclpy.node import Node

from gibson_msgs.msg import Contacts
from gibson_sim.config import PhysicsConfig
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.ros import conversions, names, qos
from gibson_sim.sensors.schedule import is_due


class ContactsPublisher:
    """Publishes all points of contact of the simulation.

    Publishes, while somebody listens:
        contacts (gibson_msgs/Contacts) at ``contacts_rate``.
    """

    def __init__(self, node: Node, config: PhysicsConfig) -> None:
        self._config = config
        self._publisher = node.create_publisher(Contacts, names.CONTACTS, **qos.overridable(qos.STATE))

    def publish(self, world: PhysicsWorld, tick: int) -> None:
        """Publishes what touched in the last step of a tick, if it is due; ``tick`` counts at ``publish_hz``."""
        rate = min(self._config.contacts_rate, self._config.publish_hz)
        if self._publisher.get_subscription_count() and is_due(tick, rate, self._config.publish_hz):
            self._publisher.publish(conversions.contacts_to_msg(world.contacts(), world.stamp_ns))
