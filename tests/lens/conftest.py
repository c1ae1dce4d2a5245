"""The demonstration lens."""

import pytest

from gpusim.lens.prescription import load_prescription


@pytest.fixture(scope="session")
def double_gauss():
    return load_prescription("double-gauss")


@pytest.fixture(scope="session")
def demo_lens(double_gauss):
    return double_gauss.scaled(8.3).stopped(2.8).limited(14.3)
