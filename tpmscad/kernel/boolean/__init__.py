"""Boolean operations of the kernel."""
