"""Plug-ins for CadQuery: the import of a module adds its methods to `cadquery.Workplane`."""
