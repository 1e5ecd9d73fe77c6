"""The scenario file: reading it with checks, and its JSON schema. ``docs/trial_file.md`` is for users."""
