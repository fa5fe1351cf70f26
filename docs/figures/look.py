"""Colours and line styles of the figures of the models."""

# Okabe and Ito (2008), as in train/reporting/figures.py; line styles tell curves apart as well.
BLUE, ORANGE, GREEN, RED, SKY = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#56B4E9"
CURVES = ((BLUE, "-"), (ORANGE, "--"), (GREEN, "-."), (RED, ":"))
