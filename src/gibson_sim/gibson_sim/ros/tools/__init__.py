"""Commands ``gibson-sim topic``, ``service``, ``param``, ``action`` and the short verbs: the tools of ``ros2`` for machines without them."""
