"""Every block, table and picture of the pages, printed anew into them: `python -m docs.reproduce`."""
