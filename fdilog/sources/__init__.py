"""From a recording to the table: which streams are gyros, their clocks, and what bears on them."""
