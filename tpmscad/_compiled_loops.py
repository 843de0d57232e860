"""The decorator of compiled loops, for every room that has some."""

from __future__ import annotations

import numba

njit_cached = numba.njit(cache=True, error_model="numpy")
"""Decorator of compiled loops: compiled on first use and cached on disk; a division by zero gives inf or nan, as in NumPy."""
