"""The report of a finished run: one HTML page that needs nothing else, and its PDF."""
