"""Many logs, one answer: find them, analyse each in a worker, keep the results, sum them up.

``audit`` is the one call behind the command line. Workers see only ``work``; the parent alone
writes the store.
"""
