"""Contacts, cavities and point loads on a mesh."""
