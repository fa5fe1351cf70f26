"""Charging on the road: booking, docking, the link between coils, and the exchange of energy."""
