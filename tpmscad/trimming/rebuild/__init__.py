"""Rebuilding: trimming loops on the lattice's and the body's faces, and the closed boundary representations of domains."""
