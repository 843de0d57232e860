"""Recipes: blends and solids of fields described in TOML files, for the command line.

Lengths are in mm, angles in degrees. A field is a table with a `kind`, a number, or the name of a field that the recipe
defines under `[fields.NAME]`. An invalid recipe raises RecipeError, whose message begins with the file, the line and the key.
The modules are loaded at their first use, because they need NumPy and the fields.
"""
