"""Surfaces with different meshes that move together: mortar integrals, and what they eliminate."""
