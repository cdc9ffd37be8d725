"""Decks of Abaqus and CalculiX: the keywords that a mesh has no need of."""
