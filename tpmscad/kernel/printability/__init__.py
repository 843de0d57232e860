"""What decides whether a solid can be printed, measured on the solid itself: overhang, closed cavities, distances of sides."""
