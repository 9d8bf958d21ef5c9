"""The published methods, one file each: the formula, then the detector that runs it on windows.

They import the nouns and the maths of ``fdilog``; only the registry imports them.
"""
