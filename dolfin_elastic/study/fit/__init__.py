"""Constants of a material from the curves of its tests."""
