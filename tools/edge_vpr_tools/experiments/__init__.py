"""Experiments whose figures the README and the documentation quote."""
