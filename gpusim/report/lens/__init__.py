"""Figures of a lens, by kind."""
