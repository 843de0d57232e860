"""Measurements that print tables: `python -m benchmarks.NAME` from the root of the repository."""
