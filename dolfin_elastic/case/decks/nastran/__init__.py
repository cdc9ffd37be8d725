"""Nastran decks as cases."""
