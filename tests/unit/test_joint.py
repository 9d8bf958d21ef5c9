from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from fdilog.detectors.joint import JointEvidence, joint_suspects, joint_test
from fdilog.maths.geometry import Floats, named_axes, parity_matrix

BIAS_SIGMA, SCALE_SIGMA, SIGMA = 0.01, 0.02, 0.05


def flown(
    axes: Floats, windows: int, samples: int = 60, seed: int = 0
) -> tuple[Floats, Floats, Floats]:
    """True readings (windows, samples, n), and healthy biases and scale errors (windows, n)."""
    rng = np.random.default_rng(seed)
    true = rng.uniform(-2.0, 2.0, (windows, samples, 3)) @ axes.T
    bias = rng.normal(0.0, BIAS_SIGMA, (windows, len(axes)))
    scale = rng.normal(0.0, SCALE_SIGMA, (windows, len(axes)))
    return true, bias, scale


def read(true: Floats, bias: Floats, scale: Floats, seed: int = 1) -> Floats:
    noise = np.random.default_rng(seed).normal(0.0, SIGMA, true.shape)
    return true * (1.0 + scale[:, None]) + bias[:, None] + noise


def test_ratios_are_those_of_the_full_covariance_of_the_window() -> None:
    axes = named_axes("pentagon")
    n = len(axes)
    sigma = np.array([0.05, 0.1, 0.05, 0.02, 0.05])
    true, bias, scale = flown(axes, 1, samples=7)
    readings = read(true, bias, scale)
    evidence = joint_test(readings, axes, sigma, BIAS_SIGMA, SCALE_SIGMA)

    whiten = np.diag(1.0 / sigma)
    parity = parity_matrix(whiten @ axes) @ whiten
    rate, *_ = np.linalg.lstsq(whiten @ axes, (readings[0] / sigma).T)
    regressors = np.vstack(
        [np.hstack([parity, parity @ np.diag(axes @ rate[:, t])]) for t in range(7)]
    )
    y = (readings[0] @ parity.T).ravel()
    prior = np.diag(np.repeat([BIAS_SIGMA**2, SCALE_SIGMA**2], n))
    inverse = np.linalg.inv(np.eye(len(y)) + regressors @ prior @ regressors.T)

    def ratio(channels: list[int]) -> float:
        columns = regressors[:, [*channels, *(c + n for c in channels)]]
        info = columns.T @ inverse @ columns
        pull = columns.T @ inverse @ y
        return float(pull @ np.linalg.solve(info, pull))

    for i in range(n):
        assert evidence.single[0, i] == pytest.approx(ratio([i]), rel=1e-6)
    for column, pair in enumerate(evidence.pairs):
        assert evidence.double[0, column] == pytest.approx(ratio(list(map(int, pair))), rel=1e-6)


def test_healthy_windows_raise_no_more_alarms_than_stated() -> None:
    axes = named_axes("dodecahedron")
    evidence = joint_test(read(*flown(axes, 4000)), axes, SIGMA, BIAS_SIGMA, SCALE_SIGMA)
    for doubt in (0.1, 0.01):
        alarms = joint_suspects(evidence, 1.0 - doubt).any(axis=1).mean()
        assert alarms <= doubt + 3 * np.sqrt(doubt / 4000)
        assert alarms > doubt / 5  # a bound that is hardly ever reached would be no use


@pytest.mark.parametrize("failed", [(2,), (1, 4)])
@pytest.mark.parametrize("kind", ["bias", "scale"])
def test_one_or_two_failed_channels_are_named(failed: tuple[int, ...], kind: str) -> None:
    axes = named_axes("dodecahedron")
    true, bias, scale = flown(axes, 200)
    # Two equal biases on a unit as regular as this one can look like two others.
    (bias if kind == "bias" else scale)[:, failed] += [0.3, -0.45][: len(failed)]
    suspects = joint_suspects(
        joint_test(read(true, bias, scale), axes, SIGMA, BIAS_SIGMA, SCALE_SIGMA), 0.999
    )
    expected = np.isin(np.arange(6), failed)
    assert (suspects == expected).all(axis=1).mean() > 0.95
    assert suspects[:, failed].all()


def test_estimates_of_bias_and_scale_are_as_good_as_they_say() -> None:
    axes = named_axes("dodecahedron")
    true, bias, scale = flown(axes, 3000)
    bias[:, 3] += 0.2
    scale[:, 3] -= 0.1
    evidence = joint_test(read(true, bias, scale), axes, SIGMA, BIAS_SIGMA, SCALE_SIGMA)
    missed = evidence.error[:, 3] - np.stack([bias[:, 3], scale[:, 3]], axis=1)
    standard = missed / evidence.error_sigma[:, 3]
    np.testing.assert_allclose(standard.mean(axis=0), 0.0, atol=0.1)
    np.testing.assert_allclose(standard.std(axis=0), 1.0, atol=0.1)


def test_a_dead_gyro_has_a_scale_error_of_minus_one() -> None:
    axes = named_axes("dodecahedron")
    true, bias, scale = flown(axes, 200)
    bias[:, 3], scale[:, 3] = 0.0, -1.0
    evidence = joint_test(read(true, bias, scale), axes, SIGMA, BIAS_SIGMA, SCALE_SIGMA)
    np.testing.assert_allclose(evidence.error[:, 3].mean(axis=0), [0.0, -1.0], atol=0.02)


def test_an_aligned_pair_stays_a_pair_of_suspects() -> None:
    axes = named_axes("aligned-triads")
    true, bias, scale = flown(axes, 100)
    bias[:, 1] += 0.5
    evidence = joint_test(read(true, bias, scale), axes, SIGMA, BIAS_SIGMA, SCALE_SIGMA)
    # The scale error multiplies the same rate in both: not even that tells them apart.
    np.testing.assert_allclose(evidence.single[:, 1], evidence.single[:, 4], rtol=1e-6)
    np.testing.assert_array_equal(
        joint_suspects(evidence, 0.999), np.tile([False, True, False] * 2, (100, 1))
    )


def test_a_window_without_rotation_says_nothing_about_scale() -> None:
    axes = named_axes("dodecahedron")
    readings = np.zeros((1, 50, 6)) + 0.3 * np.eye(6)[2]
    readings -= readings @ np.linalg.pinv(axes).T @ axes.T  # its parity part: rates are zero
    evidence = joint_test(readings, axes, SIGMA, BIAS_SIGMA, SCALE_SIGMA)
    assert evidence.error[0, 2, 0] == pytest.approx(0.3, rel=1e-6)
    assert np.isfinite(evidence.error_sigma[0, :, 0]).all()
    assert np.isinf(evidence.error_sigma[0, :, 1]).all()
    assert evidence.single[0].argmax() == 2


def test_samples_with_a_hole_are_left_out() -> None:
    axes = named_axes("dodecahedron")
    readings = read(*flown(axes, 3))
    holed = np.insert(readings, [0, 30], np.nan, axis=1)
    holed[:, 0, 1:] = 5.0
    whole = joint_test(readings, axes, SIGMA, BIAS_SIGMA, SCALE_SIGMA)
    ours = joint_test(holed, axes, SIGMA, BIAS_SIGMA, SCALE_SIGMA)
    np.testing.assert_allclose(ours.double, whole.double, rtol=1e-8)
    np.testing.assert_allclose(ours.error_sigma, whole.error_sigma, rtol=1e-8)


def test_a_window_of_holes_accuses_nobody_and_knows_nothing() -> None:
    axes = named_axes("dodecahedron")
    evidence = joint_test(np.full((1, 5, 6), np.nan), axes, SIGMA, BIAS_SIGMA, SCALE_SIGMA)
    np.testing.assert_array_equal(evidence.single, 0.0)
    assert np.isinf(evidence.error_sigma).all()
    assert not joint_suspects(evidence, 0.99).any()


def likelihoods(*ratios: float) -> JointEvidence:
    single = np.array([ratios])
    pairs: NDArray[np.intp] = np.array([[0, 1], [0, 2], [1, 2]])
    nothing = np.zeros((1, 3, 2))
    return JointEvidence(
        single=single,
        double=np.maximum(single[:, pairs[:, 0]], single[:, pairs[:, 1]]),
        pairs=pairs,
        error=nothing,
        error_sigma=nothing,
    )


@pytest.mark.parametrize(
    ("isolation", "suspects"),
    [(0.8, [True, False, False]), (0.95, [True, True, False]), (0.999, [True, True, True])],
)
def test_hypotheses_are_kept_until_they_hold_their_share(
    isolation: float, suspects: list[bool]
) -> None:
    # Likelihoods of 0.90, 0.09 and 0.01.
    evidence = likelihoods(40.0, 40.0 - 2 * np.log(10.0), 40.0 - 2 * np.log(90.0))
    np.testing.assert_array_equal(joint_suspects(evidence, 0.99, isolation), [suspects])


@pytest.mark.parametrize(
    ("sigma", "bias_sigma", "scale_sigma"), [(0.0, 1.0, 1.0), (1.0, 0.0, 1.0), (1.0, 1.0, -1.0)]
)
def test_spreads_must_be_positive(sigma: float, bias_sigma: float, scale_sigma: float) -> None:
    with pytest.raises(ValueError, match="must be positive"):
        joint_test(np.zeros((1, 2, 6)), named_axes("matasov"), sigma, bias_sigma, scale_sigma)


def test_windows_that_do_not_fit_the_axes_are_refused() -> None:
    with pytest.raises(ValueError, match=r"shape \(windows, samples, 6\)"):
        joint_test(np.zeros((2, 6)), named_axes("matasov"), 1.0, 1.0, 1.0)
