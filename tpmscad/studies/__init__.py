"""Studies: what is measured, drawn, sliced, meshed or computed of a result. Public functions are in modules of their names."""
