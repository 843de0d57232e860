"""The topological optimiser and its constraint generators."""
