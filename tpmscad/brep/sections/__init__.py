"""Plane sections of solids that repeat: curves joined from cell to cell, and clipped by the outline of a region."""
