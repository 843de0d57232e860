"""Import of a CAD body with plane and quadric faces as an exact boundary representation."""
