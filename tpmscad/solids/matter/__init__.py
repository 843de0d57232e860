"""Matter: lattices and solids of fields as closed boundary representations, larger than the body that they fill."""
