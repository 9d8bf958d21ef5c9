"""What holds of a reader whatever file it is given; no log of its format is needed."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from fdilog.conformance.claims import attempt, count, require
from fdilog.conformance.examples import written_examples
from fdilog.opening import HEAD_BYTES
from fdilog.registry import Reader

MEAN_HEADS = (
    b"",
    b"\0",
    b"\n",
    bytes(HEAD_BYTES),
    b"\xff" * HEAD_BYTES,
    b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR",
    b"\x7fELF\x02\x01\x01",
    b"%PDF-1.7\n",
    b"<!DOCTYPE html>\n<html>",
    b'{"name": "value"}\n',
    b"a line of text\nand another, with commas, in it\n",
    b"name,value\r\n1,2\r\n",
    "Text in UTF-16\n".encode("utf-16"),
)
"""Beginnings of files that are no flight logs."""
NOISES = 20


def it_says_what_it_is(name: str, reader: Reader, folder: Path) -> None:  # noqa: ARG001
    """Require suffixes and a description that a command line can show."""
    require(name and name == name.lower() and name.isprintable(), f"its name is {name!r}")
    require(isinstance(reader.suffixes, tuple), "its suffixes are no tuple")
    for suffix in reader.suffixes:
        require(re.fullmatch(r"(\.[a-z0-9_]+)+", suffix), f"{suffix!r} is no suffix")
    words = reader.description
    require(words and words.isprintable(), f"its description is no line of text: {words!r}")


def it_takes_no_other_file_for_its_own(name: str, reader: Reader, folder: Path) -> None:  # noqa: ARG001
    """Require that ``sniff`` leaves files of other kinds, and logs of other formats, alone."""
    for head in MEAN_HEADS:
        require(reader.sniff(head) is False, f"it takes {head[:16]!r} for its own")
    for other, example in written_examples().items():
        head = example.content[:HEAD_BYTES]
        require(other == name or reader.sniff(head) is False, f"it takes a {other} log for its own")
    random = np.random.default_rng(1)
    for _ in range(NOISES):
        require(reader.sniff(random.bytes(HEAD_BYTES)) is False, "it takes noise for its own")


def it_refuses_a_file_without_a_log(name: str, reader: Reader, folder: Path) -> None:  # noqa: ARG001
    """Require of nothing, a byte, rubbish one line that says why, and never a sample."""
    for number, content in enumerate(MEAN_HEADS):
        path = folder / f"{number}{reader.suffixes[0] if reader.suffixes else ''}"
        path.write_bytes(content)
        recording = attempt(reader, path)
        require(count(recording) == 0, f"it reads gyro samples in {content[:16]!r}")
        require(recording is None or len(content) > 1, f"it reads a log in {content!r}")


def it_makes_no_sample_of_noise(name: str, reader: Reader, folder: Path) -> None:  # noqa: ARG001
    """Require that random bytes hold no gyro."""
    for seed in range(NOISES):
        path = folder / f"noise{seed}{reader.suffixes[0] if reader.suffixes else ''}"
        path.write_bytes(np.random.default_rng(seed).bytes(1 << (seed % 17)))
        require(count(attempt(reader, path)) == 0, f"it reads gyro samples in noise (seed {seed})")


def it_refuses_a_file_that_is_not_there(name: str, reader: Reader, folder: Path) -> None:  # noqa: ARG001
    """Require a line that names it."""
    require(attempt(reader, folder / "absent") is None, "it reads a file that is not there")


CLAIMS = (
    it_says_what_it_is,
    it_takes_no_other_file_for_its_own,
    it_refuses_a_file_without_a_log,
    it_makes_no_sample_of_noise,
    it_refuses_a_file_that_is_not_there,
)
