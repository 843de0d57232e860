"""The level set of any field in a box as a patch complex: laid out, fitted, measured, refined or refused."""
