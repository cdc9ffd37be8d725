"""Contacts, cavities, rigid surfaces and point loads on a mesh."""
