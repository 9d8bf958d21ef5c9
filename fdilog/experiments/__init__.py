"""Known faults in recorded and simulated flights, and what becomes of them."""
