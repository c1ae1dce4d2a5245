"""Objects on a plane at a finite distance: conjugates, focus, chief rays and light.

The judges of real rays are in test_judges.py; here stand closed forms, Newton's equation and the
radiance theorem among them (Born & Wolf, sec. 4.4.2 and 4.8.1).
"""

from pathlib import Path

import numpy as np
import pytest
from lens.made import lens, model
from lens.rays import two_ovals

from gpusim.errors import UserError
from gpusim.formats.lens_file import load_prescription
from gpusim.formats.seq import parse_seq
from gpusim.formats.zmx import parse_zmx
from gpusim.lens.launch import Launch
from gpusim.lens.model import APERTURES
from gpusim.lens.samples import sample_field, sample_rays
from gpusim.lens.system import build, conjugates, first_order
from gpusim.lens.trace import trace
from gpusim.lens.wavefront import pupils

GREEN = np.array([550.0])


@pytest.mark.parametrize("name", ["double-gauss", "phone", "telephoto"])
@pytest.mark.parametrize("distance_m", [0.4, 3.0])
def test_conjugates_obey_newtons_equation(name, distance_m):
    lens_ = load_prescription(name)
    order = first_order(lens_)
    looks = conjugates(lens_.looking(distance_m))
    # The front focus, from the lens turned round: where a ray from it leaves along the axis.
    far = conjugates(lens_.looking(1e3))
    front = 1e6 - order.efl_mm**2 / (far.image_mm - order.bfl_mm)
    beyond = 1e3 * distance_m - front
    # `front` is a difference of 1e6 mm, good to 1e-16 of that over the defocus's share of it.
    assert looks.image_mm - order.bfl_mm == pytest.approx(order.efl_mm**2 / beyond, rel=1e-5)
    assert looks.magnification == pytest.approx(-order.efl_mm / beyond, rel=1e-5)
    scale = -looks.magnification * (1e3 * distance_m + order.entrance_pupil_z_mm)
    assert looks.principal_distance_mm == pytest.approx(scale, rel=1e-12)
    # N_w = N (1 - m / P), with P = exit over entrance pupil diameter.
    pupil = order.exit_pupil_diameter_mm / order.entrance_pupil_diameter_mm
    number = order.f_number * (1 - looks.magnification / pupil)
    assert looks.working_f_number == pytest.approx(number, rel=1e-12)


def test_an_object_far_away_is_an_object_at_infinity():
    far, infinite = (
        build(one)
        for one in (
            load_prescription("double-gauss").looking(1e6),
            load_prescription("double-gauss"),
        )
    )
    assert far.stop_radius_mm == infinite.stop_radius_mm
    # f^2 / s = 1e-5 mm behind the focus: 1e-5 / (8 N^2) are 6e-4 waves.
    assert far.image_z_mm == pytest.approx(infinite.image_z_mm, abs=2e-5)
    index = far.index(GREEN)
    x, y = np.array([0.0, 3.0, -5.0]), np.array([10.0, 2.0, -4.0])
    a, b = (sample_rays(s, index, np.radians(14.0), x, y) for s in (far, infinite))
    np.testing.assert_allclose(a.chief_y_mm, b.chief_y_mm, rtol=1e-6)
    np.testing.assert_allclose(a.opd_mm, b.opd_mm, rtol=0, atol=1e-3 * 550e-6)


def test_two_ovals_image_a_point_without_aberration():
    # Planted: without the sphere's part of the path, 100 waves.
    system = two_ovals()
    index = system.index(GREEN)
    looks = conjugates(system.prescription)
    assert looks.image_mm == pytest.approx(20.0, rel=1e-12)
    assert looks.magnification == pytest.approx(-20 / 30, rel=1e-12)
    radius = system.stop_radius_mm
    rays = sample_rays(system, index, 0.0, np.zeros(2), radius * np.array([0.5, 1.0]))
    np.testing.assert_allclose(rays.opd_mm, 0, atol=1e-12)
    # The sine of the marginal ray in the object is 0.25: the stop is the first surface.
    sag = 30 + first_sag(radius)
    assert radius / np.hypot(radius, sag) == pytest.approx(0.25, rel=1e-5)
    # A small field: its chief ray lands by the magnification.
    theta = np.radians(0.01)
    height = sample_rays(system, index, theta, np.zeros(1), np.zeros(1)).chief_y_mm[0]
    pupil_z = first_order(system.prescription).entrance_pupil_z_mm
    assert height == pytest.approx(20 / 30 * (30 + pupil_z) * np.tan(theta), rel=1e-6)


def test_a_numerical_aperture_is_that_of_the_marginal_ray():
    # Planted: at the first vertex the height of the pupil's rim, as from infinity.
    near = dict.fromkeys(APERTURES) | {"object_na": 0.03, "object_distance_mm": 80.0}
    system = build(load_prescription("cooke-triplet").scaled(20.0).model_copy(update=near))
    index = system.index(np.array([system.prescription.reference_nm]))
    axis = Launch(0.0, np.zeros((3, 1)), source=system.geometry.source(0.0))
    height = np.array([[80 * np.tan(np.arcsin(0.03))]])
    through = system.geometry.stop + 1
    rays = trace(system.geometry, index, axis, np.zeros((1, 1)), height, through=through)
    assert rays.y[-1, 0, 0] == pytest.approx(system.stop_radius_mm, rel=1e-12)


def first_sag(r):
    """Sag of the first hyperboloid: c r^2 / (1 + sqrt(1 - (1 + k) c^2 r^2))."""
    c = 1 / 15
    return c * r * r / (1 + np.sqrt(1 + 1.25 * c * c * r * r))


def thin():
    """Return a lens of next to no thickness, f = 50 mm, with its stop."""
    rows = [
        {"radius": np.inf, "thickness": 1e-6, "glass": "constant", "nd": 1.5},
        {"radius": -25.0},
    ]
    return lens(rows, f_number=100.0)


@pytest.mark.parametrize("distance_m", [0.1, 0.06, 1.0])
def test_bellows_take_their_light(distance_m):
    # A thin lens with its stop: sin theta' = r / hypot(r, s'), s' = f (1 + |m|), so that f/100 on
    # the axis is as bright as f/100 (1 + |m|).
    one = thin().looking(distance_m)
    system = build(one)
    index = system.index(GREEN)
    (pupil,) = pupils(sample_field(system, index, 0.0), GREEN, 1.0, 512)
    image = 1 / (1 / 50 - 1 / (1e3 * distance_m))
    radius = system.stop_radius_mm
    # Spherical aberration brings the rim's rays to the axis before that: 6e-4 of it at m = -5.
    sine2 = radius**2 / (radius**2 + image**2)
    assert pupil.projected_solid_angle_sr == pytest.approx(np.pi * sine2, rel=1e-3)
    magnification = image / (1e3 * distance_m)
    looks = conjugates(one)
    assert looks.working_f_number == pytest.approx(100 * (1 + magnification), rel=1e-6)


def test_light_on_the_axis_is_that_of_the_object_side():
    # The lens has two ovals. L Omega' dA' is L Omega dA (radiance theorem), with Omega = pi NA^2
    # and dA' = m^2 dA where the sine condition holds; two ovals keep it to third order of 0.25
    # only.
    system = two_ovals()
    (pupil,) = pupils(sample_field(system, system.index(GREEN), 0.0), GREEN, 1.0, 512)
    rim = sample_rays(
        system, system.index(GREEN), 0.0, np.zeros(1), np.array([system.stop_radius_mm])
    )
    beta = rim.beta[0, 0]
    assert pupil.projected_solid_angle_sr == pytest.approx(np.pi * beta**2, rel=1e-4)


def test_focus_is_put_where_it_is_asked_for():
    base = load_prescription("double-gauss").scaled(8.3)
    at = {d: build(base.looking(d)).image_z_mm for d in (0.3, 0.6)}
    near, crossed = base.looking(0.3), base.looking(0.3, 0.6)
    assert build(crossed).image_z_mm == at[0.6]
    assert build(base.looking(None, 0.6)).image_z_mm == at[0.6]
    assert build(near.looking(0.6)).image_z_mm == at[0.6]
    assert build(near.looking(np.inf)).image_z_mm == build(base).image_z_mm
    # Out of focus, the blur is that of the wavefront: dz sin^2 / 2.
    system = build(crossed)
    rays = sample_rays(system, system.index(GREEN), 0.0, np.zeros(1), np.array([0.7]))
    sharp = sample_rays(build(near), system.index(GREEN), 0.0, np.zeros(1), np.array([0.7]))
    dz = at[0.6] - at[0.3]
    gamma = np.sqrt(1 - rays.beta**2)
    np.testing.assert_allclose(rays.opd_mm - sharp.opd_mm, dz * (gamma - 1), rtol=0, atol=1e-9)


def test_an_as_given_plane_keeps_its_distance_from_the_focus():
    given = load_prescription("double-gauss").scaled(50.0)
    last = given.surfaces[-1].model_copy(update={"thickness": first_order(given).bfl_mm + 0.03})
    given = given.model_copy(update={"surfaces": (*given.surfaces[:-1], last), "focus": "as-given"})
    near = given.looking(0.5)
    moved = build(near).image_z_mm - system_focus(near)
    assert moved == pytest.approx(0.03, abs=1e-12)
    assert build(near.looking(np.inf)).image_z_mm == pytest.approx(
        build(given).image_z_mm, abs=1e-12
    )


def system_focus(one):
    """Place of the paraxial image."""
    return build(one.model_copy(update={"focus": "paraxial"})).image_z_mm


def test_the_f_number_is_that_of_the_barrel_and_the_glass_keeps_its_size():
    base = load_prescription("cooke-triplet")
    near = base.looking(0.15)
    assert first_order(near).f_number == first_order(base).f_number
    a, b = build(base), build(near)
    assert a.stop_radius_mm == b.stop_radius_mm
    np.testing.assert_array_equal(a.semi_diameter_mm, b.semi_diameter_mm)
    stopped = near.stopped(11.0)
    assert build(stopped).stop_radius_mm == build(base.stopped(11.0)).stop_radius_mm
    # A lens twice as large looks twice as far.
    twice = near.scaled(2 * first_order(near).efl_mm)
    assert twice.object_distance_mm == pytest.approx(300.0)
    assert build(twice).image_z_mm == pytest.approx(2 * b.image_z_mm, rel=1e-9)


@pytest.mark.parametrize(
    ("distances", "field", "allowed"),
    [
        ((0.0, None), "object_distance_m", "> 0"),
        ((float("nan"), None), "object_distance_m", "> 0"),
        ((None, -1.0), "focus_distance_m", "> 0"),
        ((0.04, None), "object_distance_m", "above 0.05"),
        ((1.0, 0.04), "focus_distance_m", "above 0.05"),
    ],
)
def test_distances_without_an_image_are_refused(distances, field, allowed):
    with pytest.raises(UserError) as caught:
        thin().looking(*distances)
    assert caught.value.field == field
    assert allowed in caught.value.allowed


def test_fields_that_meet_no_plane_are_refused():
    fisheye = load_prescription("fisheye")
    with pytest.raises(UserError, match="do not meet") as caught:
        build(fisheye.looking(0.5))
    assert caught.value.field == "max_field_deg"
    build(fisheye.limited(80.0).looking(0.5))


def test_a_numerical_aperture_needs_an_object():
    with pytest.raises(UserError, match="object_na"):
        lens([{"radius": 10.0, "thickness": 1.0, **model(1.5)}, {"radius": np.inf}], object_na=0.1)


def thin_file(kind, aperture, fields):
    """Return a thin lens, f = 50 mm, from a design program's file: an object at 75 mm, m = -2."""
    texts = {
        "zmx": f"""MODE SEQ\nUNIT MM\nENVD 20 1 0\n{aperture}\n{fields}\nWAVM 1 0.55 1\nPWAV 1
SURF 0\n  CURV 0\n  DISZ 75\nSURF 1\n  STOP\n  CURV 0\n  DISZ 1E-6
  GLAS ___BLANK 1 0 1.5 0 0 0\n  DIAM 20\nSURF 2\n  CURV -0.04\n  DISZ 150\n  DIAM 20
SURF 3\n  CURV 0\n  DISZ 0\n""",
        "seq": f"""RDM; DIM M; {aperture}; WL 587.5618; REF 1; {fields}\nSO 0 75
S 0 1E-6 500000.99999
STO\nCIR 20\nS -25 150\nCIR 20\nSI 0 0\n""",
    }
    reader = {"zmx": parse_zmx, "seq": parse_seq}[kind]
    return reader(texts[kind].encode(), Path(f"a.{kind}"))


@pytest.mark.parametrize(
    ("kind", "aperture", "fields", "number"),
    [
        ("zmx", "ENPD 1.0", "FTYP 0 0 1 1\nYFLN 8", 150.0),
        ("zmx", "FNUM 50 0", "FTYP 1 0 1 1\nYFLN 10.5405", 150.0),
        ("zmx", "FNUM 150 1", "FTYP 2 0 1 1\nYFLN -21.081", 150.0),
        ("zmx", "OBNA 0.0066665 0", "FTYP 3 0 1 1\nYFLN 21.081", 150.0),
        ("zmx", "OBNA 0.381966 1", "FTYP 1 0 1 1\nYFLN 10.5405", 150.0),
        ("seq", "EPD 1.0", "YAN 8", 150.0),
        ("seq", "FNO 150", "YOB -10.5405", 150.0),
        ("seq", "NA 0.0033333", "YIM 21.081", 150.0),
        ("seq", "NAO 0.0066665", "YRI 21.081", 150.0),
    ],
)
def test_apertures_and_fields_of_near_objects_are_read_in_every_kind(
    kind, aperture, fields, number
):
    # tan(8 deg) = 0.14054: 10.5405 mm at 75 mm, 21.081 mm in the image; all digits are six.
    read = thin_file(kind, aperture, fields)
    assert read.object_distance_mm == 75.0
    looks = conjugates(read)
    assert looks.magnification == pytest.approx(-2.0, rel=1e-4)
    assert looks.working_f_number == pytest.approx(number, rel=1e-4)
    # The real chief ray goes through the middle of a thin lens.
    assert read.max_field_deg == pytest.approx(8.0, rel=1e-4)
    assert build(read).stop_radius_mm == pytest.approx(0.5, rel=1e-4)
    said = [row.what for row in read.import_log.rows if row.how == "read"]
    assert any("object distance" in what for what in said)


def test_a_file_with_two_apertures_is_refused():
    with pytest.raises(UserError, match="two apertures"):
        thin_file("zmx", "OBNA 0.01 0\nFNUM 4 0", "FTYP 0 0 1 1\nYFLN 8")
