"""What a camera sees with its image plane moved: one survey, one trace, the moved lens's PSFs."""

from dataclasses import replace

import numpy as np
import pytest

from gpusim.camera import Camera
from gpusim.formats.lens_file import load_prescription
from gpusim.plan import Accuracy
from gpusim.plan.costs import LAVAPIPE
from gpusim.psf.compute import compute_bank
from gpusim.render import Renderer, look, planning
from gpusim.render.look import through_focus
from gpusim.scene import make_scene
from gpusim.sensor.load import load_sensor

SHIFTS_UM = (-20.0, 30.0)
ASKED = Accuracy(3e-2, 0)


@pytest.fixture(scope="module")
def camera():
    lens = load_prescription("cooke-triplet").limited(3.0)
    return Camera(lens=lens, sensor=load_sensor("arvr-640").roi(64, 64))


@pytest.fixture(scope="module")
def scene():
    return make_scene("slanted-edge")


@pytest.fixture(scope="module")
def surveys():
    """Return what lenses were asked for."""
    return []


@pytest.fixture(scope="module")
def seen(camera, scene, surveys):
    of_lens = look.bank_density
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(look, "bank_density", lambda *a, **k: surveys.append(a) or of_lens(*a, **k))
        return list(through_focus(camera, scene, ASKED, SHIFTS_UM))


@pytest.mark.slow
def test_psfs_are_those_of_the_lens_with_its_plane_there(camera, seen):
    few = [0, -1]  # fields
    for one, shift_um in zip(seen, SHIFTS_UM, strict=True):
        bank = one.bank
        window = {"pitch_um": bank.pitch_um, "size": bank.psf.shape[-1]}
        lines, fields = bank.wavelengths_nm, bank.field_deg[few]
        own = compute_bank(camera.lens.defocused(shift_um), lines, fields, **window)
        # Rays are traced to one plane and moved to another in float32: a path is rounded to some
        # 1e-6 waves, and PSFs change by a few times as much. A shift the other way changes them by
        # a tenth of the peak and more.
        assert np.abs(bank.psf[few] - own.psf).max() < 1e-5 * own.psf.max()
        assert np.abs(bank.halo[:, few] - own.halo).sum() < 1e-5 * own.halo.sum()
        # Chief rays are traced in float64 and go on along straight lines: paths of some 100 mm are
        # rounded to 1e-16 of them at each of 7 surfaces, 1e-10 um, which slopes may enlarge.
        heights = bank.real_height_um[few], own.real_height_um
        np.testing.assert_allclose(*heights, rtol=0, atol=1e-7)
    before, behind = (one.bank.psf[0, 0] for one in seen)
    assert np.abs(before - behind).max() > 0.1 * before.max()


def test_the_lens_is_surveyed_once(surveys, seen):
    first, second = seen
    assert len(surveys) == 1
    assert first.density is second.density


def test_all_positions_of_the_image_plane_share_a_survey_in_best_focus(monkeypatch, camera, scene):
    asked = []

    class AskedError(Exception):
        pass

    def survey(lens, *given, **more):
        asked.append(lens)
        raise AskedError

    monkeypatch.setattr(look, "bank_density", survey)
    moved = camera.lens.defocused(25.0).defocused(-40.0)
    given = moved.model_copy(update={"focus": "paraxial"})
    for lens in (camera.lens, moved, given):
        with pytest.raises(AskedError):
            look.look(replace(camera, lens=lens), scene, ASKED)
    assert asked == [camera.lens, camera.lens, given]
    assert [one.history for one in asked] == [one.history for one in (camera.lens,) * 2 + (given,)]


def test_a_renderer_that_is_told_what_is_seen_asks_no_lens(camera, scene, seen, monkeypatch):
    monkeypatch.setattr(planning, "look", lambda *given: pytest.fail("the lens was asked"))
    moved = replace(camera, lens=camera.lens.defocused(SHIFTS_UM[1]))
    renderer = Renderer(moved, scene, ASKED, costs=LAVAPIPE, seen=seen[1])
    assert renderer.bank is seen[1].bank
    renderer.release()
