"""Where the records of a log begin, by the formats' own specifications: for the tests to cut at."""

from __future__ import annotations

import struct

MCAP_MAGIC = 8
ULOG_HEADER = 16
ROS1_MAGIC = 13
FMT_LENGTH = 89
SQLITE_PAGE = 4096


def lines(content: bytes) -> list[int]:
    return [0, *(k + 1 for k, byte in enumerate(content) if byte == 10)][:-1]


def dataflash(content: bytes) -> list[int]:
    lengths, places, at = {128: FMT_LENGTH}, [], 0
    while at < len(content):
        places.append(at)
        kind = content[at + 2]
        if kind == 128:
            lengths[content[at + 3]] = content[at + 4]
        at += lengths[kind]
    return places


def ulog(content: bytes) -> list[int]:
    places, at = [], ULOG_HEADER
    while at < len(content):
        places.append(at)
        at += 3 + struct.unpack_from("<H", content, at)[0]
    return places


def tlog(content: bytes) -> list[int]:
    """Of packets with their stamps, MAVLink 1 or 2."""
    places, at = [], 0
    while at < len(content):
        places.append(at)
        length = content[at + 9]
        if content[at + 8] == 0xFE:
            at += 8 + 8 + length
        else:
            at += 8 + 12 + length + 13 * (content[at + 10] & 1)
    return places


def mcap(content: bytes) -> list[int]:
    """Of records at the top: chunks, indexes, the summary."""
    places, at = [], MCAP_MAGIC
    while at < len(content) - MCAP_MAGIC:
        places.append(at)
        at += 9 + struct.unpack_from("<Q", content, at + 1)[0]
    return places


def rosbag1(content: bytes) -> list[int]:
    """Of records at the top: chunks, indexes, connections."""
    places, at = [], ROS1_MAGIC
    while at < len(content):
        places.append(at)
        for _ in range(2):  # header, then data
            at += 4 + struct.unpack_from("<I", content, at)[0]
    return places


def sqlite(content: bytes) -> list[int]:
    return list(range(0, len(content), SQLITE_PAGE))
