"""Solids from shared edges."""
