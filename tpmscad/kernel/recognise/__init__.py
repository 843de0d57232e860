"""Surfaces and curves of OCCT shapes recognised as planes, quadrics and splines."""
