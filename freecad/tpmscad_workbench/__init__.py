"""A FreeCAD workbench that fills bodies with lattices by the program `tpmscad`, which runs in a Python environment of its own."""
