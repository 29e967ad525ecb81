"""Reports: pages, figures and tables of what the commands found."""

#: formats of figures, which Matplotlib writes without further libraries, and papers and pages take
FORMATS = ("png", "pdf", "svg")
