"""The model of large batches: what takes time is added up, and what binds is found."""

from __future__ import annotations

import sys
from dataclasses import replace

import pytest
from command_line import ROOT

sys.path.insert(0, str(ROOT / "tools"))
import scaling

RATES = scaling.Rates(
    start_s=3.0,
    lens_s=20.0,
    light_s=5.0,
    light_core_s=6.0,
    device_share=0.75,
    frame_s=0.04,
    frame_core_s=0.06,
    frame_bytes=1e6,
    disk_bytes_s=1e8,
)


def test_one_worker_takes_the_sum_of_its_parts():
    took = scaling.parts(RATES, 1000, 7, 1, cores=2)
    assert took == {"start": 3.0, "lens": 20.0, "lights": 35.0, "frames": 40.0, "disk": 0.0}


def test_workers_share_frames_lights_and_the_cores_of_their_machine():
    took = scaling.parts(RATES, 1000, 7, 2, cores=2)
    assert took["lights"] == 21.0  # two cores, 42 core seconds: not four of them in 20 s
    assert scaling.parts(RATES, 1000, 7, 2, cores=4)["lights"] == 20.0
    assert took["frames"] == pytest.approx(30.0)  # two cores, 60 core seconds: not 20 s
    assert scaling.parts(RATES, 1000, 7, 2, cores=4)["frames"] == pytest.approx(20.0)
    # A disk of 100 MB/s takes 10 s for 1000 MB, which is hidden behind the reading until that is
    # faster.
    took = scaling.parts(RATES, 1000, 7, 64, cores=128)
    assert took["frames"] + took["disk"] == pytest.approx(10.0)


def test_a_faster_adapter_leaves_what_the_host_does():
    took = scaling.parts(RATES, 1000, 7, 1, cores=2, faster=1e9)
    assert took["lens"] == pytest.approx(5.0) and took["lights"] == pytest.approx(8.75)


def test_the_page_says_what_binds():
    slow = replace(RATES, disk_bytes_s=1e6)
    text = scaling.page(slow, {1: 30.0, 2: 20.0})
    assert "| 64 | this one |" in text and text.rstrip().endswith("disk |")
