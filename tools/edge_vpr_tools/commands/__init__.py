"""One thin module per verb of the command line.

Each has a function `run`, which takes the parsed arguments, and raises `EdgeVprError` if one is
wrong or a file cannot be read, used or written.
"""
