"""The scenario file: loading, validation and JSON schema. User documentation: ``docs/trial_file.md``."""
