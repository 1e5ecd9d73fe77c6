"""Sub-commands of ``gibson-sim``, one module each, with an ``add_parser`` that describes its options."""
