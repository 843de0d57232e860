"""Canonical recognition: OCCT faces and edges as planes, quadrics, lines, circles and spline curves."""
