"""Analysis of fields: Betti numbers, saddles, volumes, thresholds, foot points, isometries."""
