"""The same lens from every kind of file is the same lens; a damaged file is a clear error."""

import numpy as np
import pytest
import yaml
from formats.written import pbrt_text, seq_text, zmx_text
from hypothesis import given, settings
from hypothesis import strategies as st
from lens.made import lens

from gpusim.errors import UserError
from gpusim.formats.agf import with_file_catalogues
from gpusim.formats.lens_file import _parse_yaml, load_prescription
from gpusim.formats.pbrt import parse_pbrt
from gpusim.formats.seq import parse_seq
from gpusim.formats.zmx import parse_zmx
from gpusim.lens.model import APERTURES
from gpusim.lens.samples import sample_rays
from gpusim.lens.system import build, first_order


def image_distance(prescription):
    system = build(prescription)
    return float(system.image_z_mm - system.geometry.vertex_z[-1])


def with_constant_glasses(prescription):
    """Return the lens with its printed indices at every wavelength."""
    surfaces = tuple(
        s.model_copy(update={"glass": "constant", "vd": None}) if s.glass else s
        for s in prescription.surfaces
    )
    return prescription.model_copy(update={"surfaces": surfaces})


def aspheric_lens():
    """Return a lens with conics, an even and an extended asphere, after no one's design."""
    glass = {"glass": "N-BK7", "semi_diameter": 4.0}
    rows = [
        {"curvature": 0.06, "conic": -0.6, "thickness": 3.0, **glass,
         "asphere": {"a4": -2e-5, "a6": 1e-7, "a16": 3e-16}},
        {"curvature": -0.01, "thickness": 2.0, "semi_diameter": 4.0, "conic": 1.5},
        {"curvature": 0.02, "thickness": 2.0, **glass, "asphere": {"a4": 1e-5, "a20": 1e-18}},
        {"curvature": -0.015, "semi_diameter": 4.0},
    ]  # fmt: skip
    wavelengths = (480.0, 550.0, 650.0)
    return lens(
        rows, glass_catalogues=["SCHOTT"], design_wavelengths_nm=wavelengths, reference_nm=550.0
    )


def macro_lens():
    """Return a lens designed for an object at 60 mm: the file's, and not a camera's."""
    near = dict.fromkeys(APERTURES) | {"object_na": 0.02, "object_distance_mm": 60.0}
    return load_prescription("cooke-triplet").scaled(20.0).limited(15.0).model_copy(update=near)


LENSES = {
    "macro": macro_lens,
    "double-gauss": lambda: load_prescription("double-gauss").scaled(8.3).stopped(2.8),
    "cooke-triplet": lambda: load_prescription("cooke-triplet"),
    "aspheric": aspheric_lens,
}
FORMATS = {
    "zmx": lambda p, d: parse_zmx(zmx_text(p, d).encode("utf-16"), _FILE.with_suffix(".zmx")),
    "seq, radii": lambda p, d: parse_seq(seq_text(p, d).encode(), _FILE),
    "seq, curvatures": lambda p, d: parse_seq(seq_text(p, d, radii=False).encode(), _FILE),
    "seq, inches": lambda p, d: parse_seq(seq_text(p, d, unit="I").encode(), _FILE),
    "seq, centimetres": lambda p, d: parse_seq(seq_text(p, d, unit="C").encode("utf-16"), _FILE),
}


@pytest.fixture(autouse=True)
def _in_an_empty_folder(tmp_path):
    global _FILE
    _FILE = tmp_path / "lens.seq"
    return _FILE


def assert_same_lens(read, original, tolerance):
    """First-order data, and real rays over the pupil at three fields, agree."""
    one, two = build(original), build(read)
    for name, value in vars(first_order(original)).items():
        assert getattr(first_order(read), name) == pytest.approx(value, rel=tolerance, abs=1e-12)
    assert two.stop_radius_mm == pytest.approx(one.stop_radius_mm, rel=tolerance)
    # Where only the system aperture clips, the original may leave the aperture infinite.
    np.testing.assert_allclose(two.semi_diameter_mm, one.semi_diameter_mm, rtol=tolerance)
    wavelengths = np.array(original.design_wavelengths_nm)
    assert read.design_wavelengths_nm == pytest.approx(original.design_wavelengths_nm, rel=1e-15)
    np.testing.assert_allclose(two.index(wavelengths), one.index(wavelengths), rtol=tolerance)
    x, y = (one.stop_radius_mm * np.array(v) for v in ([0.0, 0.0, 0.5, 0.9], [0.9, -0.9, 0.5, 0.0]))
    for share in (0.0, 0.7, 1.0):
        theta = np.radians(share * original.max_field_deg)
        a, b = (sample_rays(s, s.index(wavelengths), theta, x, y) for s in (one, two))
        assert a.ok.all()
        assert b.ok.all()
        size = first_order(original).efl_mm
        for name in ("chief_y_mm", "landing_x_mm", "landing_y_mm", "opd_mm"):
            np.testing.assert_allclose(
                getattr(b, name), getattr(a, name), rtol=0, atol=tolerance * size
            )


@pytest.mark.parametrize("name", LENSES)
@pytest.mark.parametrize("kind", FORMATS)
def test_the_same_lens_from_each_file_gives_the_same_rays(kind, name):
    original = LENSES[name]()
    read = FORMATS[kind](original, image_distance(original))
    assert read.max_field_deg == original.max_field_deg
    # Curvature for radius and inch for mm: roundings of 1e-16 at each of some 10 surfaces, which
    # the aberrated rays magnify some 100 times. The indices are those of the same catalogue.
    assert_same_lens(read, original, 1e-12)
    spoilt = list(read.surfaces)
    spoilt[1] = spoilt[1].model_copy(update={"thickness": spoilt[1].thickness * (1 + 1e-9)})
    with pytest.raises(AssertionError):
        assert_same_lens(read.model_copy(update={"surfaces": tuple(spoilt)}), original, 1e-12)


def test_a_pbrt_file_gives_the_same_rays_with_constant_indices():
    original = with_constant_glasses(LENSES["double-gauss"]())
    distance, radius = image_distance(original), build(original).stop_radius_mm
    read = parse_pbrt(pbrt_text(original, distance, 2 * radius).encode(), _FILE)
    # The file knows only the apertures, which let more than the published 22 deg pass.
    assert read.max_field_deg > original.max_field_deg
    stopped = {"f_number": None, "stop_semi_diameter_mm": radius, "focus": "paraxial"}
    assert_same_lens(
        read.limited(original.max_field_deg).model_copy(update={"focus": "paraxial"}),
        original.model_copy(update=stopped),
        1e-12,
    )


VIGNETTED = {
    "VDYN 0 0 0": "VDYN 0 0.05 -0.1",
    "VCYN 0 0 0": "VCYN 0 0.1 0.3",
    "VUY   0.0 0.0 0.0": "VUY   0.0 0.1 0.3",
    "FTYP 0 0": "FTYP 3 0",
}


def garbled(text, edits):
    """Return a text after edits of its lines: what happens to files in the mail."""
    lines = text.splitlines()
    for where, what, word in edits:
        if not lines:
            break
        i = int(where * len(lines))
        words = lines[i].split(" ")
        if what == "cut here":
            del lines[i:]
        elif what == "cut in the line":
            lines[i:] = [lines[i][: int(where * 1000) % (len(lines[i]) + 1)]]
        elif what == "drop":
            del lines[i]
        elif what == "double":
            lines.insert(i, lines[i])
        elif what == "swap":
            lines[i], lines[-1 - i] = lines[-1 - i], lines[i]
        else:
            words[int(where * 1000) % len(words)] = word
            lines[i] = " ".join(words)
    return "\r\n".join(lines)


ODD_WORDS = (
    st.sampled_from(
        "|0|-1|1e308|1e-308|nan|-inf|1_0|0x1F|\u0663|\x00|2026-99-99|__import__('os')".split("|")
    )
    | st.sampled_from([*"é'\"&!;#/", "S3", "SI", "MIRROR", "A_B", "9" * 400])
    | st.text(max_size=12)
)
EDITS = st.lists(
    st.tuples(
        st.floats(0, 1, exclude_max=True),
        st.sampled_from(["cut here", "cut in the line", "drop", "double", "swap", *5 * ["word"]]),
        ODD_WORDS,
    ),
    min_size=1,
    max_size=4,
)


@pytest.fixture(scope="module")
def whole_files():
    """Every kind of file, whole, with everything that the readers convert."""
    aspheric, gauss = aspheric_lens(), LENSES["double-gauss"]()
    distance = image_distance(aspheric)
    constant = with_constant_glasses(gauss)
    files = {
        "zmx": (parse_zmx, zmx_text(aspheric, distance)),
        "seq": (parse_seq, seq_text(aspheric, distance, unit="I")),
        "pbrt": (
            parse_pbrt,
            pbrt_text(constant, image_distance(constant), 2 * build(constant).stop_radius_mm),
        ),
    }
    files["yaml"] = (
        _parse_yaml,
        yaml.safe_dump(yaml.safe_load(aspheric.model_dump_json())),
    )
    for kind, (parse, text) in files.items():
        for old, new in VIGNETTED.items():
            text = text.replace(old, new)
        files[kind] = parse, text
    return files


@pytest.mark.parametrize("kind", ["zmx", "seq", "pbrt", "yaml"])
def test_a_damaged_file_is_read_or_is_a_clear_error_but_never_a_traceback(whole_files, kind):
    parse, text = whole_files[kind]
    outcomes = {"read": 0, "refused": 0}

    @settings(max_examples=40, deadline=None, derandomize=True, database=None)
    @given(edits=EDITS, codec=st.sampled_from(["utf-8", "utf-16", "cp1252"]))
    def damage(edits, codec):
        content = garbled(text, edits).encode(codec, errors="replace")
        try:
            first_order(parse(content, _FILE))
            outcomes["read"] += 1
        except UserError as error:
            # One screen: the problem and the file, and a place or what would do.
            assert error.file == _FILE
            assert error.field or error.allowed
            outcomes["refused"] += 1

    damage()
    assert min(outcomes.values()) > 0  # harmless damage is read, and the rest refused


def test_a_damaged_glass_catalogue_is_a_clear_error_but_never_a_traceback(tmp_path):
    book = tmp_path / "book.agf"
    text = "CC\nNM OWN 2 0 1.5168 64.17 0 0\nGC own\nCD 1.03961212 0.00600069867 0.231792344 "
    text += "0.0200179144 1.01046945 103.560653\nLD 0.31 2.5\nIT 0.4 0.9 10\nNM B 3 0 0 0\nCD 2"
    rows = [{"radius": 50.0, "thickness": 3.0, "glass": "OWN"}, {"radius": -50.0}]
    plain = lens(rows, glass_catalogues=[str(book)])
    outcomes = {"read": 0, "refused": 0}

    @settings(max_examples=100, deadline=None, derandomize=True, database=None)
    @given(edits=EDITS, codec=st.sampled_from(["utf-8", "utf-16", "cp1252"]))
    def damage(edits, codec):
        book.write_bytes(garbled(text, edits).encode(codec, errors="replace"))
        try:
            first_order(with_file_catalogues(plain))
            outcomes["read"] += 1
        except UserError as error:
            assert error.file in (plain.file, book)
            outcomes["refused"] += 1

    damage()
    assert min(outcomes.values()) > 0


@pytest.mark.parametrize("kind", ["zmx", "seq", "pbrt", "yaml"])
@pytest.mark.parametrize(
    "content", [b"", b"\n", b"\x89PNG\r\n\x1a\n\x00\x00", bytes(range(256)) * 9]
)
def test_what_is_no_lens_file_is_refused_with_its_name(whole_files, kind, content):
    parse, text = whole_files[kind]
    first_order(parse(text.encode(), _FILE))  # the control
    with pytest.raises(UserError) as caught:
        parse(content, _FILE)
    assert caught.value.file == _FILE
    assert caught.value.field or caught.value.allowed
