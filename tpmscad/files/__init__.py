"""Files: formats, checked writing, slabs and copies of cells. Public functions are in modules of their names."""
