"""Tangents in two stages: moduli by the form compiler, contracted with shape functions in C."""
