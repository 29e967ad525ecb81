"""Help of the flag for the formats of figures, which several commands have."""

FIGURES_HELP = "formats of the figures: png, pdf, svg, or several separated by commas"
