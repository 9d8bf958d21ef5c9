"""Text for a terminal: whatever a name in a log or a path holds is shown, none of it obeyed."""

from __future__ import annotations


def visible(text: str) -> str:
    """Put on one line whatever a text may hold: control and invisible characters as escapes."""
    return text if text.isprintable() else "".join(map(_visible, text))


def visible_lines(text: str) -> str:
    """Make a text of several lines harmless, its line feeds kept."""
    return "\n".join(visible(line) for line in text.split("\n"))


def _visible(char: str) -> str:
    if char.isprintable():
        return char
    if "\udc80" <= char <= "\udcff":  # how Python carries a byte that is not UTF-8
        return f"\\x{ord(char) - 0xDC00:02x}"
    # Spaces of another width than the usual one count as not printable.
    return " " if char.isspace() and char not in "\t\n\r\v\f\x1c\x1d\x1e\x1f\x85" else _escape(char)


def _escape(char: str) -> str:
    return ascii(char)[1:-1]
