"""Lines of a page: no peak is lost, and what the page unpacks is what was packed."""

from __future__ import annotations

import base64
import gzip

import numpy as np
import pytest
from numpy.typing import NDArray

from fdilog_reports.series import Pack, decimate

Floats = NDArray[np.float64]


def unpacked(pack: Pack) -> list[Floats]:
    """Do what the page's script does."""
    content = np.frombuffer(gzip.decompress(base64.b64decode(pack.text())), np.uint8)
    arrays, at = [], 0
    for kind, length in pack.lengths:
        planes = content[at : at + 4 * length].reshape(4, length)
        words = np.ascontiguousarray(planes.T).view("<u4").ravel()
        if kind == "time":
            arrays.append(pack.start_s + pack.step_s * np.cumsum(words.astype(float)))
        else:
            arrays.append(words.view("<f4").astype(float))
        at += 4 * length
    assert at == len(content)
    return arrays


def test_a_single_sample_survives_any_decimation() -> None:
    time_s = np.arange(720_000) / 200.0
    value = np.zeros(len(time_s))
    value[123_456], value[700_001] = 500.0, -700.0
    line = decimate(time_s, value, value, 2000)
    assert len(line.time_s) == 2000
    assert line.high.max() == 500.0
    assert line.low.min() == -700.0


def test_a_short_line_keeps_every_sample() -> None:
    time_s, value = np.arange(900) / 7.0, np.random.default_rng(1).normal(size=900)
    line = decimate(time_s, value, value, 1000)
    np.testing.assert_array_equal(line.time_s, time_s)
    np.testing.assert_array_equal(line.low, value)
    np.testing.assert_array_equal(line.high, value)


def test_every_sample_about_a_place_is_kept() -> None:
    time_s = np.arange(100_000) / 100.0
    value = np.random.default_rng(2).normal(size=len(time_s))
    line = decimate(time_s, value, value, 1000, [400.0])
    near = np.abs(time_s - 400.0) < 2.0
    kept = np.isin(time_s[near], line.time_s)
    assert kept.all()
    assert len(line.time_s) <= 1010


def test_a_band_keeps_its_outermost_edges() -> None:
    random = np.random.default_rng(3)
    low = random.normal(size=50_000)
    high = low + random.uniform(0.0, 3.0, 50_000)
    line = decimate(np.arange(5e4), low, high, 500)
    assert (line.low.min(), line.high.max()) == (low.min(), high.max())
    assert (line.low <= line.high).all()


def test_a_gap_breaks_the_line_where_it_is() -> None:
    time_s = np.concatenate([np.arange(0.0, 10.0, 0.1), np.arange(30.0, 40.0, 0.1)])
    value = np.ones(len(time_s))
    value[50] = np.nan  # one missing sample is no gap
    line = decimate(time_s, value, value, 1000)
    broken = line.time_s[np.isnan(line.low)]
    np.testing.assert_allclose(broken, [(9.9 + 30.0) / 2.0])
    assert (np.diff(line.time_s) > 0).all()


def test_what_is_missing_throughout_is_an_empty_line() -> None:
    nothing = np.full(10, np.nan)
    assert len(decimate(np.arange(10.0), nothing, nothing, 100).time_s) == 0


@pytest.mark.parametrize("start_s", [0.0, 30_000.0])
def test_times_and_values_come_back_as_finely_as_they_are_kept(start_s: float) -> None:
    random = np.random.default_rng(4)
    time_s = start_s + np.cumsum(random.uniform(1e-3, 1.0, 5000))
    value = random.normal(size=5000) * 10.0 ** random.integers(-6, 30, 5000)
    value[7], value[8] = np.nan, -0.0
    pack = Pack(start_s=start_s, span_s=float(time_s[-1] - start_s))
    assert (pack.times(time_s), pack.values(value)) == (0, 1)
    times, values = unpacked(pack)
    np.testing.assert_allclose(times, time_s, rtol=0, atol=pack.step_s)
    np.testing.assert_allclose(values, value, rtol=1.0 / 4096.0)


def test_values_beyond_what_a_browser_holds_are_the_largest_it_does() -> None:
    pack = Pack(start_s=0.0, span_s=1.0)
    pack.values(np.array([1e300, -1e300]))
    (values,) = unpacked(pack)
    np.testing.assert_allclose(values, [1e38, -1e38], rtol=1e-3)


def test_equal_arrays_are_kept_once() -> None:
    pack = Pack(start_s=0.0, span_s=1.0)
    assert pack.values(np.ones(3)) == pack.values(np.ones(3)) == 0
    assert pack.values(np.zeros(3)) == 1
    assert pack.times(np.zeros(3)) == 2  # the same bytes, but times
    assert len(unpacked(pack)) == 3
