"""Where physics and traffic meet: requests, booking, docking and transfer."""
