"""Results of small stylizations are those that were recorded: a change of the code's structure changes no result.

What is asserted, for each of the eight runs of `fingerprints.py`:

- On the machine of the record (same processor family and vector units, number of threads, variant, and versions of
  LLVM, torch, Dr.Jit, Mitsuba and numpy): every density and velocity has the recorded bits.
- There too, but driven by `prbvolpath`: it comes within 1e-5 of the norm of what the stylization changes. Mitsuba sums
  its derivatives with atomic additions, in the order in which threads come; 120 repetitions, half of them beside other
  work, came within 1e-6.
- On any other machine, where sums are rounded differently: within 1e-3 of that norm, in the density's change and in the
  velocity of the middle frame.

A change that is meant to change results, by however little, records them anew:
`python tests/helpers/fingerprints.py --record`.
"""

from __future__ import annotations

import pytest
from fingerprints import RUNS, TOLERANCE, Outcome, machine, outcome, recorded

Record = tuple[dict[str, str], dict[str, Outcome]]


@pytest.fixture(scope="module")
def record() -> Record:
    return recorded()


@pytest.mark.parametrize("name", RUNS)
def test_result_is_the_recorded_one(name: str, record: Record) -> None:
    """To the bit on the machine of the record, else to rounding; see the top of this file."""
    known, outcomes = record
    expected, found, here = outcomes[name], outcome(name), machine()
    distance = found.distance(expected)
    if here != known:
        other = {key: (known.get(key), value) for key, value in here.items() if known.get(key) != value}
        assert distance <= TOLERANCE, f"differs by {distance:.1e} of the change, on another machine: {other}"
    elif RUNS[name].rounding:
        assert distance <= RUNS[name].rounding, f"differs by {distance:.1e} of the change"
    else:
        assert not (unlike := found.unlike(expected)), f"{', '.join(unlike)}: differs by {distance:.1e} of the change"
