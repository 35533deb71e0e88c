"""The public stress scenarios, shortened, and what scenes leave out: the rows of benchmarks/stability.py and skip.py.

A criterion stands beside its number in benchmarks/stress; a failed row is shown with both.
"""

from __future__ import annotations

import pytest
import skip
from stress import base, penetration, rest, solids, steps

MODULES = (penetration, rest, solids, steps)  # their scenarios enter base.SCENARIOS when they are imported

CHEAP = ("damping", "loads", "energy", "orientation", "history", "laws")


def check(number, full):
    rows = list(base.rows_of(number, full))
    assert rows
    assert not [row for row in rows if not row.passed]


@pytest.mark.parametrize("number", sorted(base.SCENARIOS))
def test_scenario(number):
    check(number, full=False)


@pytest.mark.long
@pytest.mark.parametrize("number", ["S01", "S03", "S09", "S14", "S24", "S26", "S12", "S30", "S36"])
def test_scenario_as_listed(number):
    check(number, full=True)


def test_there_are_all_public_scenarios():
    assert set(base.SCENARIOS) == {f"S{n:02d}" for n in (1, 3, 5, 7, 9, 11, 12, 14, 16, 17, 20, 21, 22, 24, 26, 27, 28,
                                                         30, 33, 36, 38)}  # fmt: skip


@pytest.mark.filterwarnings("ignore::fdem.FdemWarning")
@pytest.mark.parametrize("name", CHEAP)
def test_what_is_left_out_changes_nothing_unless_it_matters(name):
    case = skip.CASES[name]
    runs = case.scene(True), case.scene(False)
    for sim in runs:
        sim.cycle(100)
    assert skip.difference(*(case.answer(sim) for sim in runs)) <= case.tolerance
    assert skip.difference(*case.matters()) > case.tolerance
    assert case.said in runs[1].describe()
