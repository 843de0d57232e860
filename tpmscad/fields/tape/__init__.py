"""Compiled evaluation of fields: a formula as a graph of nodes, the tape made of it, and the loop that runs it."""
