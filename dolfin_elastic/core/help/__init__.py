"""What editors, `help` and notebooks show."""
