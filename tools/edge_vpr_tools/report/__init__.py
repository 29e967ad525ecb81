"""Reports of the commands: pages, figures and tables."""

#: formats of figures, which Matplotlib writes without further libraries, and papers and pages take
FORMATS = ("png", "pdf", "svg")
