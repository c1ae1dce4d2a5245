"""Charge-transfer inefficiency by traps: against float64, in closed form; conserved; undone.

Tolerance of the stage: each group of transfers rounds a packet some times, 6 * 2^-24 of it; what
is captured goes with the volume, whose power is good to 25 ULP and the exponential of a level's
age to 3 (design notes of the adapter; WGSL allows more): 1e-5 of the traps that a packet meets.

That groups of one site are the model of arctic (Massey et al. 2014), where its traps are empty for
the first transfers, was seen by a comparison with arcticpy-no-gsl 2.6, express 0: 400 x 18 pixels
differ by 0.1 % of the effect, as much as f32 rounds in 400 passes.
"""

import numpy as np
import pytest
from harness import assert_close

from gpusim.gpu import Device, Kernel, Recording
from gpusim.reference.traps import traps
from gpusim.sensor import traps as host
from gpusim.sensor.cti_model import Cti, Species
from gpusim.sensor.traps import record_traps, restored

F32 = np.float32
WELL = 84_700.0
SPECIES = ((3.0, 5.0), (1.0, 0.7), (2.0, 40.0), (0.5, 1e3))


def model(species=SPECIES[:1], **more) -> Cti:
    kinds = tuple(Species(density=d, release_transfers=r) for d, r in species)
    return Cti(traps=kinds, **{"well_fill_power": 0.58} | more)


def shifted(device: Device, charge: np.ndarray, cti: Cti, **more) -> tuple[np.ndarray, np.ndarray]:
    rec = Recording(device)
    buffer = rec.buffer("charge", charge.shape, F32)
    rec.upload(buffer, charge)
    labels = [rec.download(array) for array in record_traps(rec, buffer, cti, well_e=WELL, **more)]
    result = rec.run()
    return tuple(result[label] for label in labels)


def expected(charge: np.ndarray, cti: Cti, **more) -> tuple[np.ndarray, np.ndarray]:
    species = [(one.density, one.release_transfers) for one in cti.traps]
    figures = {"well_fill_power": cti.well_fill_power, "notch_e": cti.notch_e, "well_e": WELL}
    return traps(charge, species, groups=min(cti.groups, len(charge)), **figures, **more)


def bound(charge: np.ndarray, cti: Cti) -> np.ndarray:
    met = sum(one.density for one in cti.traps) * (len(charge) + 1)
    return 6 * 2.0**-24 * min(cti.groups, len(charge)) * charge + 1e-5 * met


def packets(rows: int, cols: int, least: float = 300) -> np.ndarray:
    rng = np.random.default_rng(65)
    return (least + rng.integers(0, 2000, (rows, cols)) * rng.random((rows, cols)) ** 3).astype(F32)


@pytest.mark.parametrize("groups", [1, 3, 4096])
@pytest.mark.parametrize("kinds", [1, 2, 3, 4])
@pytest.mark.parametrize("shape", [(1, 1), (2, 63), (37, 4)])
def test_what_arrives_is_what_the_reference_says(device: Device, groups, kinds, shape):
    charge, cti = packets(*shape), model(SPECIES[:kinds], groups=groups)
    arrived, trapped = expected(charge, cti)
    found, left = shifted(device, charge, cti)
    assert_close(found, arrived, atol=bound(charge, cti))
    assert_close(left, trapped, atol=1e-5 * trapped)
    # Along rows it is the same of the transposed frame.
    across, _ = shifted(device, np.ascontiguousarray(charge.T), cti, serial=True)
    assert_close(across.T, found, atol=0)


def test_sites_before_the_first_packet_and_packets_without_a_site(device: Device):
    charge, cti = packets(30, 5), model(SPECIES[:2], groups=4, notch_e=50.0)
    charge[-8:] = 0
    more = {"before": 11, "overscan": 8}
    arrived, trapped = expected(charge, cti, **more)
    found, left = shifted(device, charge, cti, **more)
    assert_close(found, arrived, atol=6 * 2.0**-24 * 4 * charge + 1e-5 * 4 * 41)
    assert_close(left, trapped, rtol=1e-5)
    assert found[-8:].min() > 0  # the trails reach into the overscan
    # The control: without them, other numbers.
    assert np.abs(shifted(device, charge, cti)[0] - found).max() > 1


def test_a_trail_falls_by_the_release_time(device: Device):
    # One transfer through one site; what trails is below the notch, and is not captured again.
    charge = np.zeros((12, 1), F32)
    charge[0] = 10_000
    cti = model(((50.0, 4.0),), notch_e=1000.0)
    found, left = shifted(device, charge, cti, overscan=11)
    captured = 50 * (9000 / (WELL - 1000)) ** 0.58
    trail = captured * (1 - np.exp(-0.25)) * np.exp(-0.25 * np.arange(11))
    assert_close(found[:, 0], np.array([10_000 - captured, *trail]), rtol=1e-5)
    assert_close(left, captured * np.exp([-0.25 * 11]), rtol=1e-5)


def test_a_packet_alone_loses_at_every_site(device: Device):
    charge = np.array([[0]] * 19 + [[5000]], F32)
    left = 5000.0
    for _ in range(20):
        left -= 3 * (left / WELL) ** 0.58
    found, _ = shifted(device, charge, model(groups=20))
    assert_close(found[-1:, 0], np.array([left]), rtol=1e-5 * 60 / 5000 + 20 * 2.0**-23)
    assert not found[:-1].any()


@pytest.mark.parametrize("groups", [1, 2, 5, 40])
@pytest.mark.parametrize("kinds", [1, 4])
@pytest.mark.parametrize("what", ["sky", "sparse", "ramp", "dark"])
def test_charge_is_conserved_with_what_is_trapped(device: Device, groups, kinds, what: str):
    charge = np.zeros((400, 30), F32)
    if what == "sky":
        charge = packets(400, 30)
    elif what == "sparse":  # most packets have less than the traps would take
        charge[::37] = 5000
    elif what == "ramp":  # every cloud is lower than the one before: no level is ever taken off
        charge[:] = np.linspace(5e4, 10, 400)[:, None]
    else:
        charge[:] = np.random.default_rng(66).poisson(0.5, charge.shape)
    cti = model(tuple((8 * d, r) for d, r in SPECIES[:kinds]), groups=groups)
    found, left = shifted(device, charge, cti)
    assert found.min() >= 0
    total = found.astype(float).sum() + left.astype(float).sum()
    assert total == pytest.approx(charge.astype(float).sum(), rel=1e-6)
    assert left.sum() > 2e-6 * charge.sum()  # without it the sum would be short


def test_more_levels_than_are_kept_apart(device: Device):
    # 120 levels, of which only the old and nearly empty ones are made one.
    charge = np.linspace(6e4, 3e3, 120, dtype=F32)[:, None].repeat(2, axis=1)
    charge[60] = 5e4  # takes off many of them
    for kinds, share in ((1, 1e-4), (4, 0.01)):
        cti = model(SPECIES[:kinds], groups=2)
        arrived, _ = expected(charge, cti)
        found, _ = shifted(device, charge, cti)
        effect = np.abs(arrived - charge).max()
        assert_close(found, arrived, atol=share * effect + bound(charge, cti))


def test_few_groups_come_near_to_one_transfer_after_the_other(device: Device):
    charge = packets(300, 6)
    exact, _ = shifted(device, charge, model(groups=300))
    effect = np.sqrt(np.mean((exact - charge) ** 2))
    errors = [
        np.sqrt(np.mean((shifted(device, charge, model(groups=groups))[0] - exact) ** 2)) / effect
        for groups in (1, 2, 5)
    ]
    assert errors[0] < 0.02
    assert errors[2] < errors[1] < errors[0]


def test_packets_dispatched_apart_are_the_same_bit_for_bit(device: Device, monkeypatch):
    # Falling clouds: the pile of levels is as high as it may be when it is put aside.
    charge = np.sort(packets(100, 9), axis=0)[::-1].copy()
    for kinds in (2, 3, 4):
        cti = model(SPECIES[:kinds], groups=3)
        whole = shifted(device, charge, cti)
        with monkeypatch.context() as patch:
            patch.setattr(host, "PACKETS", 7)
            parts = shifted(device, charge, cti)
        for one, other in zip(whole, parts, strict=True):
            assert_close(other, one, atol=0)


def test_long_lines_come_through(device: Device):
    # More turns of all loops together than lavapipe allows one invocation.
    charge = packets(20_000, 2)
    found, left = shifted(device, charge, model(groups=5))
    total = found.astype(float).sum() + left.astype(float).sum()
    assert total == pytest.approx(charge.astype(float).sum(), rel=1e-6)
    assert np.all(found[-1000:] != charge[-1000:])


def test_what_was_added_is_removed(device: Device):
    charge = packets(300, 20)
    charge[-30:] = 0
    cti = model(SPECIES[:3], groups=2)
    more = {"overscan": 30}
    found, _ = shifted(device, charge, cti, **more)

    def add(rec: Recording, frame):
        return record_traps(rec, frame, cti, well_e=WELL, **more)[0]

    effect = np.sqrt(np.mean((found - charge) ** 2))
    errors = [
        np.sqrt(np.mean((restored(device, found, add, n) - charge) ** 2)) / effect for n in (1, 4)
    ]
    assert errors[1] < 0.005
    assert errors[1] < 0.2 * errors[0]  # it is the repetition that does it


def test_the_dispatch_is_as_the_header_says():
    assert Kernel("sensor/traps").workgroup_size == (64, 1, 1)
