"""Estimate of a design's cost: exact counts, instructions from tables, modelled energy."""
