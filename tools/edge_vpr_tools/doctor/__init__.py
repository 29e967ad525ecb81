"""Checks of this machine: what it has, what is missing, and how to install it."""
