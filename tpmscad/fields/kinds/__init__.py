"""Kinds of fields: each module holds one, with the public functions that make it."""
