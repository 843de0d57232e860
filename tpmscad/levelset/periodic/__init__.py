"""Patches of the level set of a periodic field: its mesh, its fit and its layers in one period."""
