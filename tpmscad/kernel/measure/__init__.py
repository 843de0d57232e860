"""Measurements by the kernel: validity, mass properties, distances."""
