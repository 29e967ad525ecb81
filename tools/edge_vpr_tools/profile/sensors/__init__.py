"""Readers of power and energy sensors."""
