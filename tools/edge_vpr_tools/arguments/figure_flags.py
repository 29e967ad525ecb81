"""The flag by which commands are told how to write figures."""

FIGURES_HELP = "formats of the figures: png, pdf, svg, or several with commas"
