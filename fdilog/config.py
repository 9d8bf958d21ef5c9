"""Configuration files: read and checked key by key, and printed with the reasons."""

from __future__ import annotations

import dataclasses
import json
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from fdilog.errors import UsageError, nearest
from fdilog.settings import (
    Config,
    DetectorSettings,
    Geometry,
    GyroSource,
    Matrix,
    Noise,
    ObserverSettings,
    Sources,
    Tolerance,
    WindowSettings,
)

__all__ = [
    "Config",
    "DetectorSettings",
    "Geometry",
    "GyroSource",
    "Matrix",
    "Noise",
    "ObserverSettings",
    "Sources",
    "Tolerance",
    "WindowSettings",
    "config_from_dict",
    "default_toml",
    "load_config",
    "read_geometry",
]


def load_config(path: Path) -> Config:
    """Read a TOML configuration.

    Raises
    ------
    UsageError
        If the file cannot be read or parsed, or holds an unknown key or a value of a wrong type;
        the text names the key and the nearest known one.
    """
    data = _read_toml(path)
    try:
        return config_from_dict(data)
    except UsageError as error:
        raise UsageError(f"{path}: {error}") from None


def _read_toml(path: Path) -> dict[str, Any]:
    try:
        with path.open("rb") as file:
            return tomllib.load(file)
    except OSError as error:
        raise UsageError(f"{path}: {(error.strerror or str(error)).lower()}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UsageError(f"{path}: not valid TOML: {error}") from error


def read_geometry(config: Config, name_or_file: str) -> Config:
    """Return a copy with the geometry of that name, or of that TOML file.

    The file holds the keys of the [geometry] section, with or without its heading.

    Raises
    ------
    UsageError
        If it is neither, or the file does not parse.
    """
    from fdilog.maths.geometry import GEOMETRIES

    if name_or_file in GEOMETRIES:
        return config.replace("geometry", name=name_or_file, axes=())
    path = Path(name_or_file)
    if not path.is_file():
        raise UsageError(f"no geometry '{name_or_file}'{nearest(name_or_file, list(GEOMETRIES))}")
    data = _read_toml(path)
    section = data if "geometry" in data else {"geometry": data}
    if set(section) != {"geometry"}:
        raise UsageError(f"{path}: holds more than a geometry; use --config")
    return dataclasses.replace(config, geometry=config_from_dict(section).geometry)


def config_from_dict(data: dict[str, Any]) -> Config:
    """Make a Config from nested plain values, checking every key and type."""
    return Config(**_section(Config, data, ""))


def _section(kind: type, data: dict[str, Any], where: str) -> dict[str, Any]:
    fields = {f.name: f for f in dataclasses.fields(kind)}
    values: dict[str, Any] = {}
    for key, value in data.items():
        name = f"{where}{key}"
        if key not in fields:
            raise UsageError(f"unknown key '{name}'{nearest(key, list(fields))}")
        values[key] = _value(name, value, kind, key)
    return values


_TABLES: dict[tuple[type, str], type] = {
    (Config, "geometry"): Geometry,
    (Config, "sources"): Sources,
    (Config, "tolerance"): Tolerance,
    (Config, "noise"): Noise,
    (Config, "windows"): WindowSettings,
    (Config, "detectors"): DetectorSettings,
    (Config, "observer"): ObserverSettings,
}
_UNITS = ("rad/s", "deg/s", "mrad/s")
# Keys for which zero has a meaning; every other number must be above zero.
_ZERO_ALLOWED = {
    "noise.bound_deg_s", "noise.bias_sigma_deg_s", "noise.scale_sigma", "noise.time_sigma_s",
    "windows.overlap", "detectors.max_failures", "tolerance.scale", "observer.threshold",
}  # fmt: skip
_BELOW_ONE = {"windows.overlap", "windows.confidence"}


def _value(name: str, value: Any, kind: type, key: str) -> Any:  # noqa: C901, PLR0911
    if (kind, key) in _TABLES:
        table = _TABLES[kind, key]
        if not isinstance(value, dict):
            raise UsageError(f"'{name}' must be a table")
        return table(**_section(table, value, f"{name}."))
    if name == "sources.gyro":
        return tuple(_gyro_source(entry) for entry in _list(name, value))
    if name == "geometry.mounting":
        return _mountings(value)
    if name == "geometry.axes":
        return tuple(_vector(name, axis, 3) for axis in _list(name, value))
    if name == "windows.lengths_s":
        lengths = tuple(sorted(_number(name, length) for length in _list(name, value)))
        if not lengths:
            raise UsageError(f"'{name}' must name at least one length")
        return lengths
    if name in _OBSERVED:
        return _OBSERVED[name](name, value)
    if name in {"sources.use", "detectors.use"}:
        return _texts(name, value)
    if name == "geometry.name":
        return _text(name, value)
    if name == "detectors.max_failures":
        if not isinstance(value, int) or isinstance(value, bool) or value < 0:
            raise UsageError(f"'{name}' must be a whole number of at least 0, not {value!r}")
        return value
    return _number(name, value)


def _number(name: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise UsageError(f"'{name}' must be a number, not {value!r}")
    number = float(value)
    too_small = number < 0 if name in _ZERO_ALLOWED else number <= 0
    too_large = number >= 1 if name in _BELOW_ONE else number == float("inf")
    if too_small or too_large or number != number:  # noqa: PLR0124  NaN
        raise UsageError(f"'{name}' = {value!r} is out of range")
    return number


def _text(name: str, value: Any) -> str:
    if not isinstance(value, str):
        raise UsageError(f"'{name}' must be text, not {value!r}")
    return value


def _list(name: str, value: Any) -> list[Any]:
    if not isinstance(value, list):
        raise UsageError(f"'{name}' must be a list, not {value!r}")
    return value


def _vector(name: str, value: Any, length: int) -> Any:
    numbers = tuple(
        float(x) for x in _list(name, value) if isinstance(x, int | float) and abs(x) < float("inf")
    )
    if len(numbers) != length or len(value) != length or not any(numbers):
        raise UsageError(f"'{name}' must hold {length} numbers, not all zero: {value!r}")
    return numbers


def _texts(name: str, value: Any) -> tuple[str, ...]:
    return tuple(_text(name, entry) for entry in _list(name, value))


def _numbers(name: str, value: Any) -> tuple[float, ...]:
    numbers = _list(name, value)
    for number in numbers:
        finite = isinstance(number, int | float) and abs(number) < float("inf")
        if isinstance(number, bool) or not finite:
            raise UsageError(f"'{name}' must hold finite numbers, not {number!r}")
    return tuple(float(number) for number in numbers)


def _matrix(name: str, value: Any) -> Matrix:
    rows = tuple(_numbers(name, row) for row in _list(name, value))
    if len({len(row) for row in rows}) > 1:
        raise UsageError(f"'{name}' must hold rows of one length: {value!r}")
    return rows


def _span(name: str, value: Any) -> tuple[float, ...]:
    span = _numbers(name, value)
    if span and not (len(span) == 2 and span[0] < span[1]):
        raise UsageError(f"'{name}' must be [from, to] in seconds, not {value!r}")
    return span


def _negatives(name: str, value: Any) -> tuple[float, ...]:
    numbers = _numbers(name, value)
    if any(number >= 0 for number in numbers):
        raise UsageError(f"'{name}' must be below zero, or the observer is not stable: {value!r}")
    return numbers


def _positives(name: str, value: Any) -> tuple[float, ...]:
    return tuple(_number(name, number) for number in _list(name, value))


def _flag(name: str, value: Any) -> bool:
    if not isinstance(value, bool):
        raise UsageError(f"'{name}' must be true or false, not {value!r}")
    return value


_OBSERVED: dict[str, Callable[[str, Any], Any]] = {
    "observer.outputs": _texts,
    "observer.inputs": _texts,
    "observer.A": _matrix,
    "observer.B": _matrix,
    "observer.C": _matrix,
    "observer.K": _matrix,
    "observer.identify": _flag,
    "observer.healthy_s": _span,
    "observer.eigenvalues_per_s": _negatives,
    "observer.units": _positives,
}


def _gyro_source(entry: Any) -> GyroSource:
    if not isinstance(entry, dict):
        raise UsageError("'sources.gyro' must be tables: [[sources.gyro]]")
    known = [f.name for f in dataclasses.fields(GyroSource)]
    for key in entry:
        if key not in known:
            raise UsageError(f"unknown key 'sources.gyro.{key}'{nearest(key, known)}")
    for key in ("name", "topic", "fields"):
        if key not in entry:
            raise UsageError(f"'sources.gyro' lacks '{key}'")
    unit = _text("sources.gyro.unit", entry.get("unit", "rad/s"))
    if unit not in _UNITS:
        raise UsageError(f"'sources.gyro.unit' = {unit!r}{nearest(unit, list(_UNITS))}")
    return GyroSource(
        name=_text("sources.gyro.name", entry["name"]),
        topic=_text("sources.gyro.topic", entry["topic"]),
        fields=tuple(
            _text("sources.gyro.fields", f) for f in _list("sources.gyro.fields", entry["fields"])
        ),
        unit=unit,
    )


def _mountings(value: Any) -> dict[str, dict[str, tuple[float, ...]]]:
    if not isinstance(value, dict):
        raise UsageError("'geometry.mounting' must be a table of sources")
    mountings: dict[str, dict[str, tuple[float, ...]]] = {}
    for source, entry in value.items():
        name = f"geometry.mounting.{source}"
        for key in entry if isinstance(entry, dict) else ():
            if key != "quaternion":
                raise UsageError(f"unknown key '{name}.{key}'{nearest(key, ['quaternion'])}")
        if not isinstance(entry, dict) or "quaternion" not in entry:
            raise UsageError(f"'{name}' must hold quaternion = [w, x, y, z]")
        mountings[source] = {"quaternion": _vector(f"{name}.quaternion", entry["quaternion"], 4)}
    return mountings


def default_toml() -> str:
    """Return the default configuration as TOML, with a reason on every key."""
    lines = ["# fdilog configuration: every key with its default; delete what you do not change."]
    for section in dataclasses.fields(Config):
        kind = _TABLES[Config, section.name]
        lines += ["", f"[{section.name}]"]
        for key in dataclasses.fields(kind):
            lines.append(f"# {key.metadata['why']}")
            default = getattr(kind(), key.name)
            comment = "# " if default in ((), {}, "") else ""
            lines.append(f"{comment}{key.name} = {_toml(default)}")
    return "\n".join(lines) + "\n"


def _toml(value: Any) -> str:
    if isinstance(value, tuple):
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    return "{}" if value == {} else json.dumps(value)
