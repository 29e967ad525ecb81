"""Figures and the self-contained page that shows them."""
