"""What every folder uses and what knows no mechanics: errors, units, schema, formulas, ranks."""

__version__ = "0.1.0"
"""The version, which stands here and nowhere else."""
