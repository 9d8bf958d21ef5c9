"""Where the gyros are in a message: found by its schema, at any depth, not by the topic's name."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

from fdilog.recording import Origin
from fdilog_readers.message_schema import NUMBERS, SEQUENCE, Field, Schema

XYZ, WXYZ = ("x", "y", "z"), ("w", "x", "y", "z")

# Deeper than any message in use; a Protobuf type may hold itself.
MAX_DEPTH = 8
MAX_UNROLLED = 12

SECONDS = ("sec", "secs", "seconds")
NANOSECONDS = ("nanosec", "nsec", "nsecs", "nanos", "nanoseconds")

# Whoever also knows where it is or how fast it goes is an estimator, not a gyro.
ESTIMATOR_FIELDS = {"position", "pose", "velocity", "linearvelocity", "twist"}

# Messages that say how the vehicle is turned, body to world, and nothing else by that name.
ATTITUDES = {
    "geometry_msgs/QuaternionStamped": ("quaternion",),
    "nav_msgs/Odometry": ("pose", "pose", "orientation"),
}

# Types whose angular velocity is in rad/s by definition, whatever language they are written in.
RADIAN_TYPES = {"sensor_msgs/Imu"}

# What a twist is part of; its topic needs no second name.
TWIST_MESSAGES = {
    "geometry_msgs/Twist",
    "geometry_msgs/TwistStamped",
    "geometry_msgs/TwistWithCovariance",
    "geometry_msgs/TwistWithCovarianceStamped",
    "nav_msgs/Odometry",
}


@dataclass(frozen=True)
class Stamp:
    """A time in a message.

    Parameters
    ----------
    name
        The words for it: ``header.stamp``.
    seconds, nanoseconds
        The two leaves.
    """

    name: str
    seconds: str
    nanoseconds: str


@dataclass(frozen=True)
class Gyro:
    """The leaves of one gyro in a message, each a dotted path from the message's top.

    Parameters
    ----------
    owner
        Path of the part that holds the gyro; empty at the top.
    attitude
        How the vehicle is turned, as something derived it: w, x, y, z.
    stamps
        Times that may belong to it, the nearest first.
    known_unit
        Whether the type says rad/s: ``sensor_msgs/Imu`` and ``geometry_msgs/Twist`` do.
    """

    owner: str
    rate: tuple[str, ...]
    accelerometer: tuple[str, ...] = ()
    orientation: tuple[str, ...] = ()
    attitude: tuple[str, ...] = ()
    stamps: tuple[Stamp, ...] = ()
    origin: Origin = "sensor"
    known_unit: bool = True

    @property
    def values(self) -> tuple[str, ...]:
        """Every leaf that becomes a column."""
        return (*self.rate, *self.accelerometer, *self.orientation, *self.attitude)

    @property
    def leaves(self) -> tuple[str, ...]:
        """Every leaf that must be read, times included."""
        times = [leaf for stamp in self.stamps for leaf in (stamp.seconds, stamp.nanoseconds)]
        return (*self.values, *times)


def find_gyros(schema: Schema, name: str) -> tuple[Gyro, ...]:
    """Find every angular rate in a message of the type ``name``, and attitudes beside them.

    A gyro is a field ``angular_velocity`` of three numbers (``sensor_msgs/Imu`` has one); the
    ``angular`` part of a ``geometry_msgs/Twist`` is an angular rate that something derived.
    """
    gyros = tuple(_search(schema, name, (), (), ()))
    known = ros_name(name)
    if known in TWIST_MESSAGES:
        gyros = tuple(replace(gyro, owner="") for gyro in gyros)
    if known not in ATTITUDES:
        return gyros
    *path, last = ATTITUDES[known]
    fields = schema.get(_type_at(schema, name, path), ())
    item = next((f for f in fields if f.name == last), None)
    attitude = _vector(schema, item, tuple(path), WXYZ)
    if gyros and attitude:
        return (replace(gyros[0], attitude=attitude), *gyros[1:])
    stamps = stamps_at(schema, name)
    found = Gyro("", (), attitude=attitude, stamps=stamps, origin="derived")
    return (*gyros, found) if attitude else gyros


def _type_at(schema: Schema, name: str, path: list[str]) -> str:
    for part in path:
        name = next((f.type for f in schema.get(name, ()) if f.name == part), "")
    return name


def lists_of_gyros(schema: Schema, name: str) -> tuple[tuple[str, str, str], ...]:
    """Return the lists whose elements hold a gyro: their path, and the type and field they are."""
    return tuple(_lists(schema, name, (), ()))


def _lists(
    schema: Schema, name: str, path: tuple[str, ...], above: tuple[str, ...]
) -> Iterator[tuple[str, str, str]]:
    if name in above or len(path) > MAX_DEPTH:
        return
    for item in schema.get(name, ()):
        if item.length == SEQUENCE and any(_search(schema, item.type, (), (), ())):
            yield ".".join((*path, item.name)), name, item.name
        elif item.length is None:
            yield from _lists(schema, item.type, (*path, item.name), (*above, name))


def with_lengths(schema: Schema, lengths: Mapping[tuple[str, str], int]) -> Schema:
    """Return a schema in which some lists, by type and field, have as many elements as given."""
    return {
        name: tuple(
            replace(item, length=lengths[name, item.name], counted=True)
            if (name, item.name) in lengths
            else item
            for item in fields
        )
        for name, fields in schema.items()
    }


def ros_name(name: str) -> str:
    """Return ``sensor_msgs/Imu`` for that type by any name: ``ros.sensor_msgs.Imu`` and others."""
    parts = [part for part in name.replace(".", "/").split("/") if part != "msg"]
    return "/".join(parts[-2:])


def number_leaves(schema: Schema, name: str) -> tuple[str, ...]:
    """Return every number of a message; of a list of numbers the path of the list itself."""
    return tuple(_numbers(schema, name, (), ()))


def stamps_at(schema: Schema, name: str, path: tuple[str, ...] = ()) -> tuple[Stamp, ...]:
    """Return the times that a part of a message carries: ``header.stamp``, ``stamp`` ..."""
    found: list[Stamp] = []
    for item in schema[name]:
        if item.length is not None or item.type not in schema:
            continue
        if item.name.lower() == "header":
            found += stamps_at(schema, item.type, (*path, item.name))
        elif item.name.lower() in {"stamp", "timestamp"}:
            names = [f.name for f in schema[item.type] if f.is_number]
            seconds = next((n for n in names if n.lower() in SECONDS), None)
            nanoseconds = next((n for n in names if n.lower() in NANOSECONDS), None)
            if seconds and nanoseconds:
                at = ".".join((*path, item.name))
                found.append(Stamp(at, f"{at}.{seconds}", f"{at}.{nanoseconds}"))
    return tuple(found)


def _search(
    schema: Schema,
    name: str,
    path: tuple[str, ...],
    above: tuple[str, ...],
    outer: tuple[Stamp, ...],
) -> Iterator[Gyro]:
    if name not in schema or name in above or len(path) > MAX_DEPTH:
        return
    stamps = (*stamps_at(schema, name, path), *outer)
    fields = {_plain(item.name): item for item in schema[name]}
    own = {"angularvelocity": fields.get("angularvelocity")}
    if ros_name(name) == "geometry_msgs/Twist":
        own = {"angular": fields.get("angular")}
    for word, item in own.items():
        rate = _vector(schema, item, path, XYZ)
        if rate:
            yield Gyro(
                ".".join(path),
                rate,
                _vector(schema, fields.get("linearacceleration"), path, XYZ),
                _vector(schema, fields.get("orientation"), path, WXYZ),
                stamps=stamps,
                origin="derived"
                if word == "angular" or ESTIMATOR_FIELDS & set(fields)
                else "sensor",
                known_unit=word == "angular"
                or "angularvelocitycovariance" in fields
                or ros_name(name) in RADIAN_TYPES,
            )
    for item in schema[name]:
        if item.type not in schema or item.length == SEQUENCE or item in own.values():
            continue
        for place in _places(item):
            yield from _search(schema, item.type, (*path, place), (*above, name), stamps)


def _places(item: Field) -> list[str]:
    if item.length is None:
        return [item.name]
    return [f"{item.name}[{k}]" for k in range(min(item.length, MAX_UNROLLED))]


def _plain(name: str) -> str:
    """Make ``angularVelocity`` and ``angular_velocity`` one word."""
    return name.replace("_", "").lower()


def _vector(
    schema: Schema, item: Field | None, path: tuple[str, ...], axes: tuple[str, ...]
) -> tuple[str, ...]:
    """Return the leaves of a vector, by its axes' names or as an array of that many numbers."""
    if item is None:
        return ()
    at = ".".join((*path, item.name))
    if item.type in NUMBERS:
        if item.length in {3, SEQUENCE} and len(axes) == 3:
            return tuple(f"{at}[{k}]" for k in range(3))
        return ()
    if item.length is not None:
        return ()
    names = {f.name for f in schema.get(item.type, ()) if f.is_number}
    return tuple(f"{at}.{axis}" for axis in axes) if names.issuperset(axes) else ()


def _numbers(
    schema: Schema, name: str, path: tuple[str, ...], above: tuple[str, ...]
) -> Iterator[str]:
    if name in above or len(path) > MAX_DEPTH:
        return
    for item in schema.get(name, ()):
        at = ".".join((*path, item.name))
        if item.type in NUMBERS:
            if item.length is None or item.length == SEQUENCE:
                yield at
            else:
                yield from (f"{at}[{k}]" for k in range(item.length))
        elif item.type in schema and item.length is None:
            yield from _numbers(schema, item.type, (*path, item.name), (*above, name))
