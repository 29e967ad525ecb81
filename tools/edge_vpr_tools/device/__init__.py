"""Designs, vectors and hardware projects of saved maps."""
