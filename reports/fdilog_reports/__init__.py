"""What people read: ``view`` puts an analysis into words and numbers, one file a format prints it.

They import the nouns of ``fdilog``; only the registry imports them, through entry points.
"""
