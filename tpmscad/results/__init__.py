"""Results: the model, the fluid domains and their certificates."""
