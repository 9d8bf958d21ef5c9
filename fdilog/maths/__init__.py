"""What needs no log: geometry, and how well a mean is known."""
