"""From the table to what comparisons rest on: windows, their noise, and what is off in them."""
