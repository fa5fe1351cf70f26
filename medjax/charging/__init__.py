"""Where physics and traffic meet: booking, docking, the link between coils, and the exchange of energy."""
