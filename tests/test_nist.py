"""NIST's certified regression problems through the calibration's solver. The benchmark prints the figures."""

from pathlib import Path

import numpy as np

from benchmarks.nist import digits, problems, solve

# From start 1 these lead away from the minimum: a first step to where a parameter has no more effect; a canyon longer
# than the steps that are allowed.
OUT_OF_REACH = {"BoxBOD", "MGH10"}


def test_certified_values_and_standard_deviations(data: Path) -> None:
    for problem in problems(data):
        second = solve(problem, 1)
        assert second.digits >= 6, problem.name
        assert second.deviation_digits >= 4, problem.name
        if problem.name not in OUT_OF_REACH:
            assert solve(problem, 0).digits >= 6, problem.name


def test_files_are_read_whole(data: Path) -> None:
    by_name = {problem.name: problem for problem in problems(data)}
    assert len(by_name) == 27
    assert by_name["Nelson"].x.shape == (2, 128)
    assert by_name["Hahn1"].y.size == 236
    bennett = by_name["Bennett5"]
    np.testing.assert_array_equal(bennett.starts, [[-2000, 50, 0.8], [-1500, 45, 0.85]])
    predicted = bennett.certified[0] * (bennett.certified[1] + bennett.x[0]) ** (-1 / bennett.certified[2])
    assert abs(((predicted - bennett.y) ** 2).sum() / bennett.squares - 1) < 1e-9


def test_digits_are_those_of_the_worst_figure() -> None:
    assert abs(digits(np.array([1.0, 2.002]), np.array([1.0, 2.0])) - 3.0) < 1e-9
    assert digits(np.array([np.nan]), np.array([1.0])) == 0.0
