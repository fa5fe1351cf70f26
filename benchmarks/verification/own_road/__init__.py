"""Travel times on a motorway of SUMO's, in SUMO and in medjax: see `compare`."""
