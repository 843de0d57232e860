"""What is trimmed and what trims it: implicit surfaces, patch sides, bodies."""
