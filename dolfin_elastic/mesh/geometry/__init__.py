"""Simplices and what is measured on them: volumes, quality, places inside cells."""
