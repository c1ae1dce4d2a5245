"""The matrix of certificates: what it keeps, and what it writes. Its judge has tests of its own."""

import importlib.util
import json
import sys
from pathlib import Path

import numpy as np
import pytest

FILE = Path(__file__).resolve().parents[1] / "tools" / "matrix.py"


@pytest.fixture(scope="module")
def matrix():
    spec = importlib.util.spec_from_file_location("matrix", FILE)
    module = importlib.util.module_from_spec(spec)
    sys.modules["matrix"] = module  # data classes look their module up
    spec.loader.exec_module(module)
    return module


def line(verdict: str, **more) -> dict:
    return {
        "lens": "a",
        "pitch_um": 4.0,
        "scene": "edge",
        "tolerance": 1e-3,
        "verdict": verdict,
    } | more


def test_there_are_the_lenses_that_were_promised(matrix):
    lenses = matrix.lenses()
    assert len(lenses) >= 12
    assert sum(not lens.is_centred for lens in lenses.values()) == 1
    for name in matrix.LIBRARY:
        wide, stopped = (
            lens.f_number or 0 for n, lens in lenses.items() if n.startswith(f"{name} f/")
        )
        assert stopped > wide


def test_the_tile_lies_on_the_same_point_at_each_pitch(matrix):
    spot = matrix.Spot(matrix.load_prescription("cooke-triplet"))
    for pitch in (1.0, 4.0, 10.0):
        for at, side in zip(spot.middle_um, spot.sides(pitch), strict=True):
            place = at / pitch + (side - 1) / 2
            assert place == round(place)
            assert matrix.TILE_PX / 2 <= place < side - matrix.TILE_PX / 2
        corner = np.hypot(*spot.sides(pitch)) * pitch / 2
        assert 0.9 * spot.circle_um < corner < spot.circle_um


def test_a_cell_done_again_replaces_the_old_one(matrix, tmp_path):
    kept = tmp_path / "cells.jsonl"
    lines = [line("met", judge_rms=1e-4), line("WRONG", judge_rms=1e-2)]
    kept.write_text("".join(json.dumps(one) + "\n" for one in lines))
    assert [one["verdict"] for one in matrix.read(kept).values()] == ["WRONG"]


def test_the_table_counts_verdicts_and_gives_reasons(matrix):
    cells = [
        line("met", total_rms=1e-4, predicted=2e-4),
        line("met", pitch_um=10.0, total_rms=1e-4, predicted=4e-4),
        line("refused", pitch_um=1.0, reason="too fine"),
    ]
    page = matrix.table(cells)
    assert "2 met, 1 refused. " in page
    assert "Predicted over total: median 3," in page
    assert "within a factor of 3 in 1 of 2 cells" in page
    assert "| a | 4 | edge | 0.001 | 2.0e-04 |  |  |  | 1.0e-04 |  | met |" in page
    assert "refused: too fine |" in page
