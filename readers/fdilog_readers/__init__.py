"""One file a log format, and ``columns``, which turns bytes, offsets and a layout into columns.

They import the nouns of ``fdilog``; only the registry imports them, through entry points.
"""
