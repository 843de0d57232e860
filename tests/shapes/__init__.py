"""Shapes, fields and deviations made by hand for the tests."""
