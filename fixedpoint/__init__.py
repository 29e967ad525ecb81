"""Exact integer arithmetic: widths of counters, codes and sums, contrast codes, activity.

Modules that use this package import from its modules, so that another library of the same name
cannot take its place.
"""
