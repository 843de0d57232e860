"""OCCT objects from arrays and back."""
