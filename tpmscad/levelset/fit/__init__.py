"""Fits to a level set: boundary curves, patches, and the quality of the result."""
