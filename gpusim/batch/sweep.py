"""A sweep: which cameras see which scenes, with what settings, and what is kept of each frame."""

from __future__ import annotations

import glob
import hashlib
import os
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field, PrivateAttr, ValidationError, field_validator

from gpusim.batch.axes import Axis, combined
from gpusim.batch.crops import Crops
from gpusim.batch.frame import OF_SCENE, Frame
from gpusim.batch.labels import label_file
from gpusim.batch.values import check_value
from gpusim.camera import Camera, load_camera
from gpusim.config.mistakes import checked, user_error
from gpusim.config.model import Fixed, Strict, Table
from gpusim.config.names import perhaps
from gpusim.config.text import read_yaml
from gpusim.errors import UserError
from gpusim.lens.perturb import OF_ELEMENT, OF_SURFACE, names_part
from gpusim.library.session import LENS_SETTINGS, READ_OUT
from gpusim.metrics.summary import MEASURES
from gpusim.plan import Accuracy
from gpusim.render.checks import rectangle
from gpusim.scene.charts import CHARTS
from gpusim.sensor.frame import areas_of
from gpusim.sensor.sensor import Sensor

if TYPE_CHECKING:
    from gpusim.batch.dataset import Dataset
    from gpusim.batch.run import Outcome

OUTPUTS = ("raw", "npz", "exr", "developed", "truth", "labels", "crops")


class Sweep(Strict):
    """What a batch renders.

    Attributes
    ----------
    camera : str
        Name or file.
    scenes : tuple of str
        Names of charts, files, or patterns of files (``photos/*.exr``).
    axes : dict of str to Axis
        By setting: of the read-out (exposure_s, iso, gain, seed, frame, temperature_c, noise), the
        lens (focal_length_mm, f_number, max_field_deg, focus_distance_m, focus_shift_um), the scene
        (luminance_cd_m2, illuminant), a figure of the sensor (sensor.FIELD, serial_number), or of a
        surface of the lens, changed by so much (lens.NUMBER.radius, curvature, thickness, nd,
        decentre_x_mm, decentre_y_mm, tilt_x_deg, tilt_y_deg). A list stands for
        ``{values: [...]}``.
    combine : str
        "product", "zip" or "sample": see `gpusim.batch.axes.combined`.
    samples, sampler, random_seed
        How "sample" draws.
    rows, cols : int, optional
        A region about the sensor's middle.
    tile : (x, y, width, height), optional
    tolerance : str
    probes : int
        Probe pixels of each light's certificate; 0: none.
    best_effort : bool
        Whether to go on where the tolerance cannot be met.
    outputs : tuple of str
        Any of raw (DNG), npz (raw, electrons, truth), exr (electrons), developed (PNG), truth
        (EXR), labels (npz), crops (npz: raw, truth, labels).
    labels : dict of str to str
        Files of each scene's labels, by name: ``depth: depth/{scene}.npy``.
    crops : Crops, optional
        Where pieces of each frame lie.
    metrics : tuple of str
        What is measured of each raw: any of `gpusim.metrics.summary.MEASURES`.

    Examples
    --------
    >>> import gpusim as gs
    >>> sweep = gs.Sweep(
    ...     camera="mtf-only", scenes=["colorchecker"], rows=48, cols=64, tolerance=1e-2, probes=0,
    ...     axes={"exposure_s": [1/240, 1/60], "seed": [1, 2]},
    ... )
    >>> sweep.check()
    >>> len(sweep.frames)
    4
    """

    camera: str
    scenes: tuple[str, ...] = Field(min_length=1)
    axes: Table[Axis] = Field(default=Fixed())
    combine: Literal["product", "zip", "sample"] = "product"
    samples: int | None = Field(default=None, ge=1)
    sampler: Literal["random", "sobol"] = "random"
    random_seed: int = Field(default=0, ge=0)
    rows: int | None = Field(default=None, ge=1)
    cols: int | None = Field(default=None, ge=1)
    tile: tuple[int, int, int, int] | None = None
    tolerance: str | float = "1e-3"
    probes: int = Field(default=16, ge=0)
    best_effort: bool = False
    outputs: tuple[str, ...] = Field(default=("raw",), min_length=1)
    labels: Table[str] = Field(default=Fixed())
    crops: Crops | None = None
    metrics: tuple[str, ...] = Field(default=())

    _folder: Path = PrivateAttr(default_factory=Path)

    def __init__(self, **fields: Any) -> None:
        try:
            super().__init__(**fields)
        except ValidationError as error:
            raise user_error(error, type(self)) from error

    @field_validator("axes", mode="before")
    @classmethod
    def _lists(cls, given: object) -> object:
        if not isinstance(given, dict):
            return given
        return {
            name: {"values": one} if isinstance(one, list | tuple) else one
            for name, one in given.items()
        }

    @classmethod
    def load(cls, path: str | Path) -> Sweep:
        """Return the sweep in a YAML file; files in it are sought beside it.

        Raises
        ------
        UserError
            No such file, or a field is wrong.

        Examples
        --------
        >>> import gpusim as gs
        >>> from pathlib import Path
        >>> _ = Path("sweep.yaml").write_text("{camera: mtf-only, scenes: [colorchecker]}")
        >>> gs.Sweep.load("sweep.yaml").outputs
        ('raw',)
        """
        path = Path(path)
        sweep = checked(cls, read_yaml(path, "the sweep file"), path)
        sweep._folder = path.parent
        sweep.check()
        return sweep

    def check(self) -> None:
        """Refuse what cannot be rendered before anything is.

        Raises
        ------
        UserError
        """
        for name in self.outputs:
            if name not in OUTPUTS:
                raise UserError(
                    f"there is no such output{perhaps(name, OUTPUTS)}",
                    field="outputs",
                    value=name,
                    allowed=", ".join(OUTPUTS),
                )
        self._check_labels_crops_metrics()
        Accuracy.parse(str(self.tolerance), self.probes)
        for name, axis in self.axes.items():
            _check_axis(name)
            for value in axis.listed:
                check_value(name, value)
                if name.startswith(("lens.", "sensor.")) or name in LENS_SETTINGS:
                    Frame(self, "", {name: value}).camera()
        first = self.frames[0]
        sensor = first.camera().sensor
        rect = rectangle(self.tile, sensor)
        if self.crops is not None:
            areas = areas_of(rect, sensor.frame)
            self.crops.places(areas.active, rect[2:], self.random_seed, 0)
        for step in self.axes["iso"].listed if "iso" in self.axes else ():
            self.base.sensor.at_iso(int(step))
        for step in self.axes["gain"].listed if "gain" in self.axes else ():
            self.base.sensor.at_gain(step)

    def _check_labels_crops_metrics(self) -> None:
        """Refuse outputs that lack what they are made of, and measures that there are not."""
        for name in ("labels", "crops"):
            if name in self.outputs and not getattr(self, name):
                raise UserError(
                    f"the output {name} needs the field {name}", field="outputs", value=name
                )
        for name in self.metrics:
            if name not in MEASURES:
                raise UserError(
                    f"there is no such measure{perhaps(name, MEASURES)}",
                    field="metrics",
                    value=name,
                    allowed=", ".join(MEASURES),
                )
        if self.metrics and "raw" not in self.outputs:
            raise UserError(
                "what is measured is the raw",
                field="metrics",
                value=", ".join(self.metrics),
                allowed="the output raw beside it",
            )
        for name in ("xy", "raw", "truth_dn"):
            if name in self.labels:
                raise UserError(
                    "crops have something else of this name",
                    field="labels",
                    value=name,
                    allowed="any other name",
                )
        for pattern in self.labels.values():
            for scene in self.scene_names:
                label_file(self.folder, pattern, scene)

    @property
    def folder(self) -> Path:
        """Where its files are sought first."""
        return self._folder

    @cached_property
    def base(self) -> Camera:
        """The camera before any setting."""
        beside = self._folder / self.camera
        camera = load_camera(beside if beside.suffix and os.path.exists(beside) else self.camera)
        if self.rows is None and self.cols is None:
            return camera
        sensor = camera.sensor
        region = sensor.roi(self.rows or sensor.rows, self.cols or sensor.cols)
        return Camera(camera.lens, region, camera.title)

    @cached_property
    def scene_names(self) -> list[str]:
        """Charts and files, patterns resolved.

        Raises
        ------
        UserError
            A pattern that no file has.
        """
        names = []
        for one in self.scenes:
            if one in CHARTS:
                names.append(one)
                continue
            found = sorted(glob.glob(str(self._folder / one))) or sorted(glob.glob(one))
            if not found:
                raise UserError(
                    f"no chart and no file{perhaps(one, CHARTS)}",
                    field="scenes",
                    value=one,
                    allowed="the name of a chart (gpusim charts), a file, or a pattern of files",
                )
            names += found
        return names

    @cached_property
    def frames(self) -> list[Frame]:
        """The frames, those of one light after another."""
        settings = combined(self.axes, self.combine, self.samples, self.sampler, self.random_seed)
        frames = [Frame(self, scene, values) for scene in self.scene_names for values in settings]
        groups: dict[str, list[Frame]] = {}
        for frame in frames:
            groups.setdefault(frame.light_key, []).append(frame)
        return [
            Frame(self, one.scene, one.settings, number)
            for number, one in enumerate(one for group in groups.values() for one in group)
        ]

    def run(self, out: str | Path, **options: Any) -> Outcome:
        """Render the frames into a folder, on Dask: see `gpusim.batch.run.run`.

        Examples
        --------
        >>> import gpusim as gs
        >>> sweep = gs.Sweep(
        ...     camera="mtf-only", scenes=["colorchecker"], rows=48, cols=64,
        ...     tolerance=1e-2, probes=0,
        ... )
        >>> sweep.run("frames").new  # starts a process, which takes seconds  # doctest: +SKIP
        1
        """
        from gpusim.batch.run import run

        self.check()
        return run(self, Path(out), **options)

    @property
    def digest(self) -> str:
        """What tells this sweep from others: a digest of all that it says."""
        text = self.model_dump_json()
        return hashlib.blake2b(text.encode(), digest_size=12).hexdigest()

    def dataset(self, *, shard: int = 0, shards: int = 1, prefetch: int = 2) -> Dataset:
        """Return the frames, or their crops, as an iterable for training; no files are written.

        Each is a `gpusim.batch.dataset.Sample`: raw, clean, labels, parameters. PyTorch takes it
        as an ``IterableDataset`` once told so; its DataLoader's workers then share the samples.

        Parameters
        ----------
        shard, shards : int
            Which part of how many, for processes that train side by side.
        prefetch : int
            Samples that a thread makes ahead of the reader.

        Raises
        ------
        UserError
            No such shard, or what `check` refuses.

        Examples
        --------
        >>> import gpusim as gs
        >>> sweep = gs.Sweep(
        ...     camera="mtf-only", scenes=["colorchecker"], axes={"seed": {"range": [0, 4]}},
        ...     rows=48, cols=64, tolerance=1e-2, probes=0,
        ...     crops={"rows": 16, "cols": 16, "count": 3},
        ... )
        >>> data = sweep.dataset(shard=1, shards=2)
        >>> data
        Dataset(6 samples of 2 frames, shard 1 of 2)
        >>> [(one.parameters["seed"], one.raw.shape) for one in data][::3]
        [(2, (16, 16)), (3, (16, 16))]
        """
        from gpusim.batch.dataset import Dataset

        return Dataset(self, shard, shards, prefetch)

    def __len__(self) -> int:
        return len(self.frames)


def _check_axis(name: str) -> None:
    """Refuse an axis that names nothing."""
    known = [*READ_OUT, *LENS_SETTINGS, *OF_SCENE, "serial_number"]
    if name in known:
        return
    first, _, rest = name.partition(".")
    if first == "sensor" and rest in Sensor.model_fields:
        return
    if first == "lens" and names_part(rest):
        return
    names = [*known, *(f"sensor.{field}" for field in Sensor.model_fields)]
    raise UserError(
        f"there is no such setting{perhaps(name, names)}",
        field=f"axes.{name}",
        allowed=f"{', '.join(known)}; sensor.FIELD of a sensor file; lens.NUMBER.WHAT with "
        f"{', '.join(OF_SURFACE)}; lens.element.FIRST-LAST.WHAT with {', '.join(OF_ELEMENT)}",
    )
