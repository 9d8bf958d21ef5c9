"""The errors a user can meet; each is one clear line, and nothing else reaches the terminal."""

from __future__ import annotations


class FdilogError(Exception):
    """Something a user can understand and mend; its text is the line the user reads."""


class UnreadableLogError(FdilogError):
    """Nothing in this log could be saved; the text says at which byte and why."""


class NoGyroError(FdilogError):
    """The log was read, but holds no gyro channels; the text names the streams there are."""


class UsageError(FdilogError):
    """An option, a configuration key or a name is wrong; the text names the nearest known one."""


def nearest(name: str, known: list[str]) -> str:
    """Return the ending "; did you mean 'x'?" or, where nothing is near, what is known."""
    import difflib

    close = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    return f"; did you mean '{close[0]}'?" if close else f"; known: {', '.join(known)}"
