"""What editors and `help` show."""
