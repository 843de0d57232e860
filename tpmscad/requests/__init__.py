"""Requests: the keywords of lattices, infills and fluid domains, validated into frozen values."""
