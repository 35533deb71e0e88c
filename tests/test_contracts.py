"""Every joint law keeps every contract (see contracts.py)."""

from __future__ import annotations

import pytest
from contracts import CONTRACTS, LAWS


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("contract", CONTRACTS, ids=lambda c: c.__name__)
def test_joint_law(contract, name):
    contract(LAWS[name])
