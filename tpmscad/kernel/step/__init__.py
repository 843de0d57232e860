"""STEP files: what is written of patch complexes with shared geometry, and of any shape of the kernel."""
