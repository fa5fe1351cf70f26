"""The figures of the models' pages, drawn by the functions that they are about: `python -m docs.figures`."""
