"""Ready-made lenses: PSFs or an MTF that somebody else computed or measured, as a ``Bank``.

One loader for all: by its suffix and content a path is

- a saved bank (``.nc``, as ``Bank.save`` and ``gpusim lens LENS --out`` write it);
- NumPy arrays (``.npz``): those of `NPZ_ARRAYS`, with the shapes of ``Bank``;
- a folder that ISETCam's Zemax macro wrote, or its ISETPARMS.TXT (`gpusim.formats.isetcam_lens`);
- a YAML file that lists Zemax's text exports (`gpusim.formats.zemax_text`);
- a YAML file with a table of the MTF (`gpusim.formats.mtf`).

A camera takes the first four as ``lens: {bank: PATH}``, the last as ``lens: {mtf: PATH}``. Nothing
in any file is ever executed. What a format does not hold must be stated in a YAML file; an error
names what is missing, and where to put it.
"""

from __future__ import annotations

import contextlib
import os
import zipfile
import zlib
from collections.abc import Callable
from importlib import resources
from pathlib import Path

import numpy as np
from pydantic import PrivateAttr

from gpusim.config.arrays import read_npz
from gpusim.config.mistakes import checked
from gpusim.config.model import Strict
from gpusim.config.text import read_bytes, read_mapping
from gpusim.errors import UserError
from gpusim.formats.assemble import unit_psf
from gpusim.formats.contract import check_bank, check_plane_bank
from gpusim.formats.text import decoded
from gpusim.known import Known
from gpusim.psf.bank import Bank
from gpusim.psf.cone import with_exit_pupil
from gpusim.psf.field_bank import FieldBank
from gpusim.psf.plane_bank import PlaneBank
from gpusim.psf.sampling import WAVELENGTHS_NM

# Names in an .npz file, with the shapes, units and meanings of the same names in Bank; title and
# source are texts. A PSF may have any positive sum. What the file lacks is looked up under the
# same name in the YAML file beside it: lens.yaml for lens.npz. There may be exit_pupil_mm, from
# which the angles of the light at the image follow: see gpusim.psf.cone.
NPZ_ARRAYS = (
    "wavelengths_nm",
    "reference_nm",
    "field_deg",
    "ideal_height_um",
    "real_height_um",
    "psf",
    "pitch_um",
    "relative_illumination",
    "projected_solid_angle_sr",
    "transmission",
    "efl_mm",
    "f_number",
    "title",
    "source",
)
ISETPARMS = "isetparms.txt"
MTF_TABLE = "MTF table"
ACCEPTED = (
    "a saved bank (.nc), NumPy arrays (.npz), a folder with ISETPARMS.TXT, or a .yaml file that "
    "lists Zemax exports (psf_files) or gives a table of the MTF (mtf)"
)


class ReadyLens(Strict):
    """A lens of which only the bank is known: it can be used, and not be changed.

    Attributes
    ----------
    title, source, notes : str
    kind : str
        What it was read from.
    file : str
        Its name.
    """

    title: str
    source: str
    notes: str
    kind: str
    file: str

    _bank: FieldBank = PrivateAttr()
    _path: Path = PrivateAttr()

    @property
    def path(self) -> Path:
        """Where it was read from."""
        return self._path

    @property
    def history(self) -> tuple[str, ...]:
        """What was done since the file was read: nothing can be."""
        return ()

    @property
    def known(self) -> tuple[Known, ...]:
        """Over which wavelengths its PSFs are known: what is seen, and as far as they reach."""
        lines, eye = self._bank.wavelengths_nm, WAVELENGTHS_NM
        ends = min(lines[0], eye[0]), max(lines[-1], eye[-1])
        return (Known("the lens's file", *map(float, ends)),)

    def bank(self, progress: Callable[[int, int], None] | None = None) -> FieldBank:
        """Return the bank; nothing is left to compute."""
        return self._bank


def ready_lens(bank: FieldBank, kind: str, file: Path) -> ReadyLens:
    """Return the lens of a bank that was read from a file."""
    facts = {
        "title": bank.provenance["title"],
        "source": bank.provenance.get("source", "not stated"),
        "notes": bank.provenance.get("notes", ""),
        "kind": kind,
        "file": file.name,
    }
    lens = checked(ReadyLens, facts, file)
    lens._bank, lens._path = bank, file
    return lens


def mtf_presets() -> dict[str, Path]:
    """Return the MTF-only lenses that come with the package: name to file."""
    folder = Path(str(resources.files("gpusim") / "data" / "mtf"))
    return {path.stem: path for path in sorted(folder.glob("*.yaml"))}


def is_ready(name_or_path: str | Path) -> bool:
    """Tell a ready-made lens from a prescription, by the name and what a YAML file lists."""
    path = mtf_presets().get(str(name_or_path), Path(name_or_path))
    suffix = path.suffix.lower()
    if suffix in (".yaml", ".yml") and os.path.isfile(path):
        # A file that is no mapping is for the reader of prescriptions to refuse.
        with contextlib.suppress(UserError):
            return not {"mtf", "psf_files"}.isdisjoint(read_mapping(path, "the lens file"))
    return os.path.isdir(path) or suffix in (".nc", ".npz", ".txt")


def load_ready(name_or_path: str | Path) -> ReadyLens:
    """Read a ready-made lens; its kind is recognised.

    Raises
    ------
    UserError
        Where there is no such file, it is not whole, or something is missing from it: names the
        file, the field, its value and what is allowed.
    """
    path = mtf_presets().get(str(name_or_path), Path(name_or_path))
    suffix = path.suffix.lower()
    if os.path.isdir(path):
        inside = [entry for entry in path.iterdir() if entry.name.lower() == ISETPARMS]
        if not inside:
            raise UserError("the folder holds no ISETPARMS.TXT", file=path, allowed=ACCEPTED)
        path, suffix = inside[0], ".txt"
    if not os.path.exists(path):
        raise UserError("no such lens", field="lens", value=name_or_path, allowed=ACCEPTED)
    if suffix == ".nc":
        return ready_lens(_netcdf(path), "saved bank", path)
    if suffix == ".npz":
        return ready_lens(_npz(path), "NumPy arrays", path)
    if path.name.lower() == ISETPARMS:
        from gpusim.formats.isetcam_lens import read_isetcam

        return ready_lens(read_isetcam(path), "ISETCam ray-trace folder", path)
    if suffix in (".yaml", ".yml"):
        data = read_mapping(path, "the lens file")
        if "mtf" in data:
            from gpusim.formats.mtf import read_mtf

            return ready_lens(read_mtf(data, path), MTF_TABLE, path)
        if "psf_files" in data:
            from gpusim.formats.zemax_text import read_zemax

            return ready_lens(read_zemax(data, path), "Zemax text exports", path)
        raise UserError(
            "the file is no ready-made lens",
            file=path,
            field="mtf or psf_files",
            value=", ".join(map(str, data)) or "nothing",
            allowed="mtf for a table of the MTF, psf_files for Zemax's exports",
        )
    if decoded(read_bytes(path, "the lens file")[:200]).lstrip().startswith("Listing of"):
        raise UserError(
            "one Zemax export is not a lens: it holds one field at one wavelength",
            file=path,
            allowed="a .yaml file beside the exports, with psf_files: [...] and what they do not "
            "hold",
        )
    raise UserError("the file is no ready-made lens", file=path, allowed=ACCEPTED)


def _netcdf(path: Path) -> FieldBank:
    """Read a saved bank, of a lens with an axis or without."""
    import h5py

    try:
        # For a broken file, h5netcdf would leave an object that complains when it is collected.
        with h5py.File(path, "r") as file:
            names, _ = list(file), list(file.attrs)
        bank = (PlaneBank if "field_x_deg" in names else Bank).load(path)
    except (OSError, ValueError, KeyError, RuntimeError, TypeError, AttributeError) as error:
        raise UserError(
            f"not a whole bank: {' '.join(str(error).split())}",
            file=path,
            allowed="a NetCDF file as gpusim lens LENS --out bank.nc writes it",
        ) from error
    missing = {"title", "history"} - bank.provenance.keys()
    if missing:
        raise UserError(
            "the bank does not say what it is of",
            file=path,
            field=sorted(missing)[0],
            allowed="a global attribute of that name",
        )
    if isinstance(bank, PlaneBank):
        check_plane_bank(bank, path)
    else:
        check_bank(bank, path)
    return bank


def _npz(path: Path) -> Bank:
    """Read a bank from NumPy's arrays, and from the YAML file beside them."""
    values = _npz_values(path)
    texts = {name: str(values[name]) for name in ("title", "source")}
    arrays = {name: _numbers(values[name], name, path) for name in NPZ_ARRAYS if name not in texts}
    if "exit_pupil_mm" in values:
        arrays["exit_pupil_mm"] = _numbers(values["exit_pupil_mm"], "exit_pupil_mm", path)
    for name in ("reference_nm", "pitch_um", "efl_mm", "f_number", "exit_pupil_mm"):
        if name not in arrays:
            continue
        if arrays[name].size != 1:
            raise UserError(
                "one number is needed", file=path, field=name, value=f"{arrays[name].size} numbers"
            )
        arrays[name] = float(arrays[name].item())
    pupil_mm = arrays.pop("exit_pupil_mm", None)
    if pupil_mm is not None and not pupil_mm > 0:
        raise UserError(
            "the exit pupil does not lie before the image",
            file=path,
            field="exit_pupil_mm",
            value=pupil_mm,
            allowed="above 0, or left out",
        )
    psf = arrays.pop("psf")
    if psf.ndim != 4 or psf.shape[2] != psf.shape[3]:
        raise UserError(
            "a variable of the bank is wrong",
            file=path,
            field="psf",
            value=f"shape {psf.shape}",
            allowed="shape (fields, wavelengths, n, n)",
        )
    window, share = unit_psf(psf, path)
    unknown = np.full(psf.shape[:2], np.nan)
    bank = Bank(
        psf=window.astype(np.float32),
        outside_energy=1 - share,
        folded_energy=unknown,
        fit_residual_waves=unknown,
        failed_rays=unknown,
        provenance={
            **texts,
            "patent": "none",
            "notes": "",
            "history": f"read from {path.name}",
            "not_known": "folded_energy, fit_residual_waves, failed_rays",
        },
        **arrays,
    )
    check_bank(bank, path)
    return bank if pupil_mm is None else with_exit_pupil(bank, pupil_mm)


def _npz_values(path: Path) -> dict[str, object]:
    """Return what stands under the names of `NPZ_ARRAYS` and others, in either file."""
    beside = path.with_suffix(".yaml")
    values = read_mapping(beside, "the file of the lens's fields") if os.path.exists(beside) else {}
    try:
        values |= read_npz(path)
    except (
        # NotImplementedError: an unknown compression; RuntimeError: encrypted.
        *(OSError, ValueError, KeyError, EOFError, RuntimeError, NotImplementedError, SyntaxError),
        *(zipfile.BadZipFile, zlib.error),
    ) as error:
        raise UserError(
            f"not a whole .npz file: {' '.join(str(error).split())}",
            file=path,
            allowed="arrays as numpy.savez writes them, without objects",
        ) from error
    for name in NPZ_ARRAYS:
        if name not in values:
            raise UserError(
                f"{name} is missing",
                file=path,
                field=name,
                allowed=f"{', '.join(NPZ_ARRAYS)}, in this file or in {beside.name}",
            )
    return values


def _numbers(value: object, name: str, file: Path) -> np.ndarray:
    """Return a value as float64, or refuse it."""
    try:
        found = np.asarray(value)
    except ValueError:  # ragged
        found = np.asarray(None)
    if found.dtype.kind not in "iuf":
        raise UserError("a value is not a number", file=file, field=name, allowed="numbers")
    return found.astype(np.float64)
