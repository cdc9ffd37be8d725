"""The case file: its tables, its check, and the run that it describes."""
