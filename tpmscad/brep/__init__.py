"""Boundary representations in arrays, and what is measured on them without the kernel."""
