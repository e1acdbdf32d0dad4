"""A transport run: the problem, its batches, what they leave."""
