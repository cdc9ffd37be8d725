"""The command `look`."""
