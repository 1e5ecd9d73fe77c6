"""Messages as bytes (CDR), their types, and a check that DDS carries them whole."""
