"""Solids: the functions that make a certified solid of a surface, a field or a body. Each is in a private module of its name."""
