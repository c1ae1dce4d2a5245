"""Spectra from files: each format gives its numbers, fine ones keep their light, some are none."""

import json
import time

import numpy as np
import pytest
from harness import assert_close

from gpusim.errors import UserError
from gpusim.scene import make_scene
from gpusim.scene.spd import on_grid, read_spectrum
from gpusim.scene.spectra import ALL_NM, WAVELENGTHS_NM, illuminant, illuminant_known

NM = np.arange(380.0, 781.0, 10.0)
POWER = 1 + np.sin(NM / 40) ** 2
TM27 = (
    '<?xml version="1.0" encoding="UTF-8"?>\n<IESTM2714 xmlns="iestm2714" version="1.0">'
    "<Header><Description>made up</Description></Header>\n<SpectralDistribution>"
    "<SpectralQuantity>flux</SpectralQuantity>\n{}</SpectralDistribution></IESTM2714>\n"
)


def written(at, kind: str):
    """Write NM and POWER in a format; return the file."""
    pairs = list(zip(NM.tolist(), POWER.tolist(), strict=True))
    lines = {
        "csv": "nm,power\n# a remark\n" + "\n".join(f"{nm},{one}" for nm, one in pairs),
        "txt": "\n".join(f"{nm}  {one}  # here" for nm, one in pairs),
        "json": json.dumps({"wavelengths_nm": NM.tolist(), "values": POWER.tolist()}),
        "map.json": json.dumps({str(nm): one for nm, one in reversed(pairs)}),
        "spdx": TM27.format(
            "\n".join(f'<SpectralData wavelength="{nm}">{one}</SpectralData>' for nm, one in pairs)
        ),
    }
    file = at / f"lamp.{kind}"
    file.write_text(lines[kind])
    return file


@pytest.mark.parametrize("kind", ["csv", "txt", "json", "map.json", "spdx"])
def test_each_format_gives_its_numbers(tmp_path, kind: str):
    file = written(tmp_path, kind)
    nm, power = read_spectrum(file, "the lamp")
    assert_close(nm, NM, atol=0)
    assert_close(power, POWER, atol=0)
    assert_close(illuminant(str(file)), np.interp(WAVELENGTHS_NM, NM, POWER), rtol=1e-14)
    assert illuminant_known(str(file))[1:] == (380.0, 780.0)
    scene = make_scene("grey", luminance_cd_m2=100.0, illuminant=str(file))
    shape = scene.white / np.interp(WAVELENGTHS_NM, NM, POWER)
    assert_close(shape, np.full(61, shape[0]), rtol=1e-12)
    assert scene.white_luminance_cd_m2 == pytest.approx(100.0)
    assert scene.illuminant == file.name


def test_colour_science_reads_and_writes_the_same_tm27(tmp_path):
    colour = pytest.importorskip("colour", reason="reads and writes IES TM-27")
    theirs = colour.SpectralDistribution_IESTM2714(str(tmp_path / "lamp.spdx"))
    theirs.domain, theirs.range = NM, POWER
    theirs.header.description = "made up"
    theirs.spectral_quantity = "flux"
    assert theirs.write()
    nm, power = read_spectrum(tmp_path / "lamp.spdx", "the lamp")
    assert_close(nm, NM, atol=1e-12)
    assert_close(power, POWER, rtol=1e-11)  # it writes twelve digits


def test_a_spectrum_of_the_grid_or_coarser_is_straight_between():
    found = on_grid(NM, POWER, ALL_NM, 5.0)
    assert_close(found, np.interp(ALL_NM, NM, POWER), atol=0)


@pytest.mark.parametrize("at", [500.0, 502.5, 503.7])
def test_a_fine_spectrum_keeps_the_light_of_its_lines(at: float):
    nm = np.arange(400.0, 701.0, 0.1)
    line = np.exp(-0.5 * ((nm - at) / 0.4) ** 2)
    found = on_grid(nm, line, WAVELENGTHS_NM, 5.0)
    # Trapezia of 0.1 nm over a line of 0.4 are exact; both neighbours share the line by distance.
    assert found.sum() * 5 == pytest.approx(0.4 * np.sqrt(2 * np.pi), rel=1e-6)
    assert np.sum(found * WAVELENGTHS_NM) / found.sum() == pytest.approx(at, abs=1e-6)
    smooth = on_grid(nm, 3 + 0.01 * nm, WAVELENGTHS_NM, 5.0)
    # Straight spectra stay as they are, but at the ends, beyond which they go on level.
    assert_close(smooth[1:-1], 3 + 0.01 * WAVELENGTHS_NM[1:-1], rtol=1e-9)


WRONG = {
    "a.csv": ("nm,power\n400,1\nfive,2\n", "line 3"),
    "b.csv": ("400,1\n390,2\n", "line 2"),
    "c.csv": ("400,1\n410,-2\n", "line 2"),
    "d.csv": ("400,nan\n410,2\n", "line 1"),
    "e.csv": ("", None),
    "f.csv": ("200,1\n300,1\n", None),
    "a.json": ('{"nm": [1, 2]}', None),
    "b.json": ('[["400", 1]]', None),
    "c.json": ('{"wavelengths_nm": [400, 500], "values": [1]}', None),
    "a.spdx": ("<a><SpectralData wavelength='400'>1</SpectralData>", None),
    "b.spdx": ("<!DOCTYPE a [<!ENTITY b 'c'>]><a>&b;</a>", None),
    "c.spdx": (TM27.format("<SpectralData>1</SpectralData>"), "SpectralData 1"),
    "d.spdx": ("<a/>", None),
}


@pytest.mark.parametrize("name", WRONG)
def test_mistakes_are_one_clear_error_soon(tmp_path, name: str):
    text, field = WRONG[name]
    file = tmp_path / name
    file.write_text(text)
    started = time.process_time()
    with pytest.raises(UserError) as caught:
        make_scene("grey", illuminant=str(file))
    assert time.process_time() - started < 2
    assert caught.value.file == file
    assert caught.value.field == field
    assert caught.value.allowed
