"""Data of fields: sampled grids, images and tables of points."""
