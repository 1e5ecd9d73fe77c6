"""Commands ``gibson-sim topic``, ``node``, ``service``, ``param``, ``action`` and the short verbs: those of ``ros2`` for machines without it."""
