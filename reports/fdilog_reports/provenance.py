"""How to get the same report again: the command, and the configuration as a file."""

from __future__ import annotations

import dataclasses
import math
import re
import shlex
from collections.abc import Mapping
from typing import Any

from fdilog.analysis import Part
from fdilog.config import Config
from fdilog_reports.words import encodable

CONFIG_FILE = "fdilog.toml"

_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")


def command(path: str, config: Config, part: Part | None = None) -> str:
    """Return the command line that repeats the analysis of a log, or of a part of it."""
    options = [] if config == Config() else ["--config", CONFIG_FILE]
    part = part or Part()
    if math.isfinite(part.start_s):
        options += ["--from", repr(float(part.start_s))]
    if math.isfinite(part.end_s):
        options += ["--to", repr(float(part.end_s))]
    if part.armed:
        options.append("--armed")
    return " ".join(["fdilog", "analyse", _shell_word(path), *options])


def _shell_word(path: str) -> str:
    """Quote a path for the shell, as $'...' where it holds what does not print."""
    word = f"./{path}" if path.startswith("-") and path != "-" else path
    if word.isprintable():
        return shlex.quote(word)
    parts = [
        char if char.isprintable() and char not in "\\'" else _shell_escape(char) for char in word
    ]
    return f"$'{''.join(parts)}'"


def _shell_escape(char: str) -> str:
    if char in "\\'":
        return f"\\{char}"
    return "".join(f"\\x{byte:02x}" for byte in char.encode("utf-8", "surrogateescape"))


def configuration(config: Config) -> str:
    """Return every setting as TOML that `fdilog analyse --config` reads back."""
    lines: list[str] = []
    for section, values in dataclasses.asdict(config).items():
        lines += _table(f"[{section}]", values, section)
    return "\n".join(lines).strip() + "\n"


def _table(header: str, values: Mapping[str, Any], name: str) -> list[str]:
    lines, below = ["", header], []
    for key, value in values.items():
        if isinstance(value, Mapping):
            for entry, inner in value.items():
                path = f"{name}.{key}.{_key(entry)}"
                below += _table(f"[{path}]", inner, path)
        elif value and isinstance(value, tuple) and isinstance(value[0], Mapping):
            for inner in value:
                below += _table(f"[[{name}.{key}]]", inner, f"{name}.{key}")
        else:
            lines.append(f"{key} = {_value(value)}")
    return lines + below


def _key(key: str) -> str:
    return key if _BARE_KEY.fullmatch(key) else _string(key)


def _value(value: Any) -> str:
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(_value(item) for item in value)}]"
    if isinstance(value, str):
        return _string(value)
    return str(value).lower() if isinstance(value, bool) else repr(value)


def _string(text: str) -> str:
    parts = []
    for char in encodable(text):
        if char in '\\"':
            parts.append(f"\\{char}")
        elif char.isprintable():
            parts.append(char)
        else:
            parts.append(f"\\U{ord(char):08x}")
    return f'"{"".join(parts)}"'
