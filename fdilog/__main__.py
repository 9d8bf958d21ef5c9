"""`python -m fdilog`."""

from fdilog.cli import main

main()
