"""Explicit time integration with a lumped mass and a stable step."""
