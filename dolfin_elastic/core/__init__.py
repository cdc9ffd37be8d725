"""What every folder uses and what knows no mechanics: errors, units, schema, formulas, ranks."""
