"""STEP files (ISO 10303-21): writers for boundary representations and for any OCCT shape, and a reader."""
