"""Plane sections of solids in many layers, as closed contours."""
