"""Figures and the page of a report."""
