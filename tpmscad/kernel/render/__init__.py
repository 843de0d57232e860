"""Pictures of shapes, rendered in software without a display."""
