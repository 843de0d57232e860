"""The operands of a trim: patch sides of the lattice, and the trimming body with its implicit surfaces and face regions."""
