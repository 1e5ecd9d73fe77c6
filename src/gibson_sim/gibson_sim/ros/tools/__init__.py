"""What ``gibson-sim topic``, ``service``, ``param`` and the short verbs do: the tools of ``ros2`` for machines without them."""
