"""Plug-ins for CadQuery: importing one gives `cadquery.Workplane` its methods."""
