"""Jinja2 with escaping on for every value, in HTML and in Markdown alike."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jinja2 import Environment

FOLDER = Path(__file__).parent / "templates"

# JSON allows these escapes in every string; nothing of a script element's syntax is left.
SCRIPT_SAFE = str.maketrans(
    {"<": r"\u003c", ">": r"\u003e", "&": r"\u0026", "\u2028": r"\u2028", "\u2029": r"\u2029"}
)

# Everything that CommonMark or its tables and autolinks could take for markup. An underscore
# inside a word is none, and most channel and topic names would be unreadable with it escaped.
_MARKDOWN = re.compile(r"[\\`*\[\]<>|#~!&@]|(?<=:)/|(?<![^\W_])_|_(?![^\W_])|(?i:(?<=www)\.)")
_NUMBER_AND_UNIT = re.compile(r"(?<=\d) (?=(?:deg/s|s|%)(?:\W|$))")
_BACKTICKS = re.compile("`+")


class Verbatim(str):
    """Text that is part of the Markdown itself."""

    __slots__ = ()


def markdown_text(value: Any) -> str:
    """Escape a value for Markdown, unless it is `Verbatim`."""
    if isinstance(value, Verbatim):
        return value
    return _MARKDOWN.sub(lambda found: "\\" + found[0], str(value))


def code_block(text: str, language: str = "") -> Verbatim:
    """Fence a text with more backticks than it holds anywhere."""
    longest = max((len(run) for run in _BACKTICKS.findall(text)), default=0)
    fence = "`" * max(3, longest + 1)
    return Verbatim(f"{fence}{language}\n{text.rstrip()}\n{fence}")


def unbroken(sentence: str) -> str:
    """Keep a number and its unit on one line."""
    return _NUMBER_AND_UNIT.sub("\u00a0", sentence)


@cache
def html_environment() -> Environment:
    """Return the environment of the HTML template."""
    environment = _environment(autoescape=True)
    environment.filters["unbroken"] = unbroken
    return environment


@cache
def markdown_environment() -> Environment:
    """Return the environment of the Markdown template."""
    environment = _environment(autoescape=False)
    environment.finalize = markdown_text
    environment.filters["code"] = code_block
    return environment


def _environment(*, autoescape: bool) -> Environment:
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    return Environment(
        loader=FileSystemLoader(FOLDER),
        autoescape=autoescape,  # noqa: S701  Markdown has its own, in `finalize`
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
