"""The files of one frame of a batch: its outputs, and the sidecar that says that all are there."""

from __future__ import annotations

import json
import math
import time
from contextlib import nullcontext
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import gpusim
from gpusim.batch.kept import DEVICE, SIDECAR, kept_labels, recipe_name
from gpusim.batch.labels import in_frame
from gpusim.disk import beside, put
from gpusim.errors import UserError
from gpusim.library.recipe import recipe_of_frame
from gpusim.metrics.picture import read_picture
from gpusim.metrics.summary import summary
from gpusim.scene.exr import write_exr

if TYPE_CHECKING:
    from gpusim.batch.frame import Frame
    from gpusim.library import frame as library

# What a frame's file ends with, by output.
KINDS = {
    "raw": "dng",
    "npz": "npz",
    "exr": "exr",
    "developed": "png",
    "truth": "truth.exr",
    "labels": "labels.npz",
    "crops": "crops.npz",
}
LABELLED = {"labels", "crops"}  # outputs that hold labels
COMPUTED = {"npz", "exr", "developed", "truth", "crops"}  # outputs that take the device once more
NOT_MEASURED = ".not_measured"  # after a measure's name: why it has no figures


@dataclass(frozen=True, eq=False)
class FrameFiles:
    """What is written of a frame of a batch.

    Attributes
    ----------
    frame : Frame
        What the sweep says of it.
    taken : library.Frame
        What came of it.
    out : Path
        Folder of the batch.
    taken_at : datetime
        The time in its raw.
    """

    frame: Frame
    taken: library.Frame
    out: Path
    taken_at: datetime

    def write(self, lit_s: float, started: float) -> tuple[dict[str, Any], dict[Path, Path]]:
        """Write the files beside their places; return what the sidecar holds, and the places.

        The sidecar comes last: where that is, all are.

        Parameters
        ----------
        lit_s : float
            Seconds that the frame's light took.
        started : float
            When the work on the frame began.
        """
        frame, out = self.frame, self.out
        labels: dict[str, np.ndarray] = {}
        if frame.sweep.labels and not LABELLED.isdisjoint(frame.sweep.outputs):
            with DEVICE:
                labels = in_frame(kept_labels(frame, out), self.taken)
        places: dict[Path, Path] = {}
        try:
            files = [f"{frame.name}.{KINDS[kind]}" for kind in frame.sweep.outputs]
            for kind, name in zip(frame.sweep.outputs, files, strict=True):
                part = beside(out / name)
                places[part] = out / name
                with DEVICE if kind in COMPUTED else nullcontext():
                    self._write(kind, part, labels)
            facts = self._facts()
            facts |= {"files": files, "light_s": lit_s, "seconds": time.perf_counter() - started}
            sidecar = out / f"{frame.name}{SIDECAR}"
            part = beside(sidecar)
            places[part] = sidecar
            part.write_text(json.dumps(facts, default=_plain))
        except BaseException:
            for part in places:
                part.unlink(missing_ok=True)
            raise
        return facts, places

    def _write(self, kind: str, part: Path, labels: dict[str, np.ndarray]) -> None:
        """Write one output."""
        if kind == "truth":
            write_exr(part, {"Y": self.taken.truth_dn}, units="DN")
        elif kind == "labels":
            _save_arrays(part, labels)
        elif kind == "crops":
            _save_arrays(part, crops_of(self.frame, self.taken, labels))
        elif kind == "raw":
            self.taken.write_raw(part, 0.0, self.taken_at)
        else:
            self.taken.save(part)

    def _facts(self) -> dict[str, Any]:
        """Return what the sidecar says of the frame itself."""
        frame, taken = self.frame, self.taken
        certificate, made = taken.certificate, {}
        if "raw" in frame.sweep.outputs:
            name = f"{frame.name}.{KINDS['raw']}"
            part, light = beside(self.out / name), recipe_name(frame)
            made["recipe"] = recipe_of_frame(taken, part, self.taken_at, light=light)
            made["recipe"] |= {"raw": name}
        return {
            "number": frame.number,
            "scene": frame.scene,
            "settings": frame.settings,
            "exposure_s": taken.exposure_s,
            "iso": taken.iso,
            "seed": taken.shot.seed,
            "frame": taken.shot.frame,
            **_level(taken.raw),
            "saturated": np.count_nonzero(taken.saturated) / taken.raw.size,
            **_measured(frame, self.out),
            "certificate_rms": None if certificate is None else certificate.total_rms,
            "certificate_met": None if certificate is None else certificate.met,
            "gpusim": gpusim.__version__,
            "sweep": frame.sweep.digest,
            **made,
        }


def put_in_place(frame: Frame, facts: dict[str, Any], places: dict[Path, Path]) -> dict[str, Any]:
    """Put files into their places, once they are on disk; return the facts, or why they are not."""
    try:
        for part, path in places.items():
            put(part, path)
    except OSError as error:
        return failed(frame, error)
    finally:
        for part in places:
            part.unlink(missing_ok=True)
    return facts


def failed(frame: Frame, error: UserError | OSError) -> dict[str, Any]:
    """Return the account of a frame that is not there."""
    said = str(error)
    if isinstance(error, UserError):
        parts = error.problem, error.field, error.value, error.allowed
        said = " ".join(str(one) for one in parts if one)
    return {"number": frame.number, "settings": frame.settings, "error": said}


def _level(raw: np.ndarray) -> dict[str, float]:
    """Return mean and standard deviation of a raw, DN."""
    deviation = raw.astype(np.float64)
    mean = float(deviation.mean())
    deviation -= mean  # once: NumPy's own functions convert the raw three times
    np.square(deviation, out=deviation)
    return {"mean_dn": mean, "std_dn": math.sqrt(deviation.mean())}


def crops_of(
    frame: Frame, taken: library.Frame, labels: dict[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Return ``xy`` (n, 2), and the crops (n, rows, cols) of ``raw``, ``truth_dn`` and labels."""
    crops, seed = frame.sweep.crops, frame.sweep.random_seed
    assert crops is not None  # the sweep is checked
    places = crops.places(taken.areas.active, taken.raw.shape, seed, frame.number)
    planes = {"raw": taken.raw, "truth_dn": taken.truth_dn, **labels}
    return {"xy": places, **{name: crops.cut(plane, places) for name, plane in planes.items()}}


def _save_arrays(part: Path, arrays: dict[str, np.ndarray]) -> None:
    with part.open("wb") as file:  # given a name, NumPy would add a suffix to it
        np.savez_compressed(file, **arrays)


def _measured(frame: Frame, out: Path) -> dict[str, Any]:
    """Return figures of a frame's raw file, and why there are none."""
    if not frame.sweep.metrics:
        return {}
    planes = read_picture(beside(out / f"{frame.name}.{KINDS['raw']}"))
    figures, failed = summary(planes, frame.sweep.metrics)
    return figures | {f"{name}{NOT_MEASURED}": why for name, why in failed.items()}


def _plain(value: object) -> object:
    return value.item() if isinstance(value, np.generic) else str(value)
