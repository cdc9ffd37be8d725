"""Commands beside computing: to begin with, to convert, and to show what was computed."""
