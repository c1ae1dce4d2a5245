"""What is to be convolved, and how well: the scene, the PSFs, and what cutting these costs."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from gpusim.optics import paint, warp
from gpusim.optics.chief_ray import ChiefRayMap, chief_ray_map
from gpusim.optics.grid import SimGrid
from gpusim.optics.highlight_plan import HighlightPlan, plan_highlights
from gpusim.optics.images import field_images, mirrored
from gpusim.optics.kernels import FieldKernels, core_window, distances_um, field_kernels
from gpusim.optics.modes import Decomposition
from gpusim.optics.nodes import Scale
from gpusim.optics.spectral_basis import Basis
from gpusim.plan.accuracy import Accuracy
from gpusim.plan.alias import Alias
from gpusim.plan.blocks import Needed
from gpusim.plan.contrast import contrast_of, edge_contrast
from gpusim.plan.costs import Costs
from gpusim.plan.halo import seen_shares
from gpusim.plan.lens import LATERAL
from gpusim.plan.predict import Edge, cells_within, cut_error
from gpusim.plan.shares import TAIL_SHARE
from gpusim.psf.field_bank import FieldBank
from gpusim.psf.places import Places
from gpusim.scene.chart import Chart
from gpusim.scene.raster import PlacedRaster
from gpusim.scene.scene import Scene
from gpusim.sensor.planes import Planes, planes_of
from gpusim.sensor.sensor import Sensor

# Radii at which the core of the PSFs may be cut from their tail, um.
CUTS_UM = (6.0, 8.0, 12.0, 16.0, 24.0, 32.0, 48.0)
CUTS_TRIED = 3  # the smallest that meet the tolerance: a larger core only costs more


@dataclass(frozen=True, eq=False, kw_only=True)
class Problem:
    """What is to be convolved, and how well.

    `accuracy` is what the bank leaves of the tolerance to the engine.
    """

    bank: FieldBank
    sensor: Sensor
    scene: Scene
    accuracy: Accuracy
    costs: Costs
    basis: Basis
    force: Collection[str]
    levels: tuple[FieldBank, ...]
    # What sim grids cost, by samples a pixel and planes: the same at every tolerance.
    aliases: dict[tuple[int, int], float] = field(default_factory=dict)

    def has_basis(self, basis: Basis) -> bool:
        """Return whether the planes are those of a basis, wherever they are seen."""
        return basis.elsewhere is self.basis.elsewhere is None and np.array_equal(
            basis.spectra, self.basis.spectra
        )

    def to(self, accuracy: Accuracy) -> Problem:
        """Return the same for another accuracy, with all that was worked out and holds there.

        Kernels of the fields take most of a plan's time: a search for the nearest tolerance that
        can be met makes them once.
        """
        other = replace(self, accuracy=accuracy)
        found = {name: value for name, value in vars(self).items() if name not in vars(other)}
        for name in ("tails", "highlights"):  # nodes, angles and squares: as many as it needs
            found.pop(name, None)
        vars(other).update(found)
        return other

    @cached_property
    def planes(self) -> Planes:
        """How the sites lie on planes."""
        return planes_of(self.sensor)

    @property
    def sites(self) -> list[int]:
        """Channel of each plane."""
        return list(self.planes.channels)

    # The scene

    @cached_property
    def is_chart(self) -> bool:
        """Whether the scene is painted."""
        return isinstance(self.scene.source, Chart)

    @cached_property
    def has_edges(self) -> bool:
        """Whether anything changes over the scene: not in a chart that is all background."""
        return not self.is_chart or len(self.scene.source.primitives) > 0

    @property
    def sigma(self) -> float:
        """Gaussian low-pass of the sampled scene, sim samples."""
        return paint.SIGMA if self.is_chart else 0.0

    @cached_property
    def half_um(self) -> tuple[float, float]:
        """Half of the width and of the height of the sensor."""
        sensor = self.sensor
        return tuple(n * sensor.pixel_pitch_um / 2 for n in (sensor.cols, sensor.rows))

    @cached_property
    def chief_ray(self) -> ChiefRayMap:
        """Where the image points lie."""
        return chief_ray_map(self.bank, "distortion" in self.force)

    @cached_property
    def placed(self) -> Chart | PlacedRaster:
        """The scene on the ideal image plane."""
        if self.is_chart:
            return self.scene.source.placed(self.half_um[1])
        return self.scene.source.placed(*self.half_um, 0.0)

    @cached_property
    def highlights(self) -> HighlightPlan | None:
        """How the light of a photograph's highlights is summed; None where pixels see none."""
        if self.is_chart or not len(self.placed.highlights):
            return None
        return plan_highlights(
            self.bank,
            self.sensor,
            self.placed.highlights,
            self.scene.spectra,
            self.accuracy.tolerance,
            wavelengths_nm=self.scene.wavelengths_nm,
        )

    @cached_property
    def seen_shares(self) -> np.ndarray:
        """What pixels see of the halo: see `gpusim.plan.halo.seen_shares`."""
        return seen_shares(self.levels, self.scene, self.half_um)

    def identity(self, scale: Scale) -> bool:
        """Return whether the raster's samples are those of the sim grid.

        One of another pitch is never identical, and placing a finer one takes a while.
        """
        return (
            not self.is_chart
            and bool(np.isclose(self.placed.pitch_um, scale.pitch_um, rtol=1e-9))
            and warp.is_identity(
                self.scene.source.placed(*self.half_um, scale.pitch_um), scale, self.chief_ray
            )
        )

    def needed(self, grid: SimGrid, pitch_um: float) -> Needed:
        """Return the planes that each block needs; worked out once for all methods."""
        if (grid, pitch_um) not in self._found_needed:
            where = (self.placed, self.basis.coefficients, grid, pitch_um, self.chief_ray)
            found = (paint if self.is_chart else warp).planes_by_block(*where)
            self._found_needed[grid, pitch_um] = found
        return self._found_needed[grid, pitch_um]

    @cached_property
    def _found_needed(self) -> dict[tuple[SimGrid, float], Needed]:
        return {}

    # What grids and cuts cost

    def grid_error(self, oversampling: int) -> float:
        """Return what the sim grid costs; where all is of one tone, nothing."""
        if not self.has_edges:
            return 0.0
        key = oversampling, self.basis.coefficients.shape[1]
        if key not in self.aliases:
            self.aliases[key] = self.alias.error(oversampling)
        return self.aliases[key]

    @cached_property
    def alias(self) -> Alias:
        """What sim grids cost."""
        return Alias(
            self.images,
            self.places,
            self.bank.pitch_um,
            self.sensor,
            self.placed,
            self.basis.coefficients,
            self.chief_ray,
            self.sigma,
            math.lcm(*self.sensor.period),
        )

    @property
    def contrast(self) -> float:
        """By how much what PSFs lack far out counts more where the scene is dark."""
        return contrast_of(self.placed)

    def edge(self, pitch_um: float) -> Edge:
        """Return the scene's edges on a sim grid."""
        pixel = max(round(self.sensor.pixel_pitch_um / pitch_um), 1)
        return Edge(self.edge_contrast, pixel)

    @cached_property
    def edge_contrast(self) -> float:
        """How hard the edges of the scene are."""
        light = self.scene.spectra.sum(axis=1)
        return edge_contrast(self.placed, light, self.half_um, self.chief_ray.real_um)

    @cached_property
    def lost(self) -> dict[float, float]:
        """Return what cuts cost, by radius."""
        fit = [cut for cut in CUTS_UM if cut < self.reach_um / 2]
        where = (self.bank.pitch_um, self.coarse_pitch_um, self.sensor)
        probes = self.images[list(self.places.probes)]
        return {cut: cut_error(probes, *where, cut) for cut in fit}

    @cached_property
    def tails(self) -> dict[float, tuple[float, tuple[int, int]]]:
        """Return what the tails' nodes cost and the fewest cells between them, by cut to try."""
        limit = self.accuracy.tolerance / self.contrast
        fit = [cut for cut, lost in self.lost.items() if lost <= limit]
        return {cut: self._tail_nodes(cut) for cut in fit[:CUTS_TRIED]}

    def _tail_nodes(self, cut_um: float) -> tuple[float, tuple[int, int]]:
        """Return the error that the tails' nodes leave, and the fewest cells between them."""
        weight = self.weights(cut_um)[1]
        middle = len(self.sensor.channels) // 2
        # The tail holds some per cent of the energy, and its error counts as much less.
        images = self.images[self.places.main, 0, middle]
        share = float(((images * weight).sum(axis=(1, 2)) / images.sum(axis=(1, 2))).max())
        few, lag = cells_within(
            self.first(weight, self.coarse_pitch_um),
            self.coarse_pitch_um,
            self.reach_um,
            self.half_um,
            TAIL_SHARE * self.accuracy.tolerance / share,
            beyond_um=self.reach_um,
        )
        return lag * share, few

    # The PSFs

    @cached_property
    def _images(self) -> tuple[np.ndarray, Places]:
        # Sources around the sensor count too, and so do the nodes beyond them.
        farthest_um = float(np.hypot(*self.half_um) + np.sqrt(2) * self.reach_um)
        basis, lateral = self.basis, LATERAL in self.force
        given = {"elsewhere": basis.elsewhere, "wavelengths_nm": basis.wavelengths_nm}
        return field_images(self.bank, basis.rates, farthest_um, force=lateral, **given)

    @property
    def images(self) -> np.ndarray:
        """Images of the PSFs at the fields (F, J, C, n, n)."""
        return self._images[0]

    @property
    def places(self) -> Places:
        """Where the fields lie."""
        return self._images[1]

    @cached_property
    def mirrored(self) -> bool:
        """Whether kernels of mirrored places are mirrored."""
        return mirrored(self.images[:, 0], self.places)

    @cached_property
    def reach_um(self) -> float:
        """How far from their chief rays the PSFs reach."""
        return self.bank.psf.shape[-1] / 2 * self.bank.pitch_um + self.bank.lateral_um

    @property
    def coarse_stride(self) -> int:
        """Sim samples of the tails' grid from a photosite to the next of its site."""
        # Half a sample a pixel, but a whole one for 4 x 4 sites: between samples each would have
        # kernels of its own, and shaders/optics/fft_columns sums four.
        return 4 if self.planes.period == 4 else 1

    @property
    def coarse_pitch_um(self) -> float:
        """Pitch of the tails' grid."""
        return self.sensor.pixel_pitch_um * self.planes.period / self.coarse_stride

    def weights(self, cut_um: float | None) -> list[np.ndarray]:
        """Return the weights of the samples of the PSFs in each scale."""
        n = self.images.shape[-1]
        if cut_um is None:
            return [np.ones((n, n))]
        core = core_window(distances_um(n, self.bank.pitch_um), cut_um)
        return [core, 1 - core]

    def first(self, weight: np.ndarray, pitch_um: float) -> FieldKernels:
        """Return kernels of the first plane in green, or the only channel: the list's middle.

        In all channels where the quantum efficiency of each goes with the place in its own way.
        """
        if self.basis.elsewhere is not None:
            return self.channels(weight, pitch_um)
        middle = len(self.sensor.channels) // 2
        images = self.images[:, :1, middle : middle + 1]
        return field_kernels(images, self.places, self.bank.pitch_um, pitch_um, weight)

    def channels(self, weight: np.ndarray, pitch_um: float) -> FieldKernels:
        """Return kernels of the first plane in all channels."""
        images = self.images[:, :1]
        return field_kernels(images, self.places, self.bank.pitch_um, pitch_um, weight)

    @cached_property
    def guesses(self) -> dict[tuple, Decomposition]:
        """Modes that were guessed: see `gpusim.plan.modes`."""
        return {}


@dataclass(frozen=True, eq=False)
class Sampled:
    """PSFs, or their core or tail, on a sim grid.

    Attributes
    ----------
    name : str
        The scale's: "whole", "core" or "tail".
    stride : int
        Sim samples from a photosite to the next of its site.
    pitch_um : float
    reach_um : float
        How far from the chief ray.
    weight : ndarray (n, n)
        Weight of the PSFs' samples.
    cells : (int, int)
        The fewest cells between PSF nodes.
    """

    name: str
    stride: int
    pitch_um: float
    reach_um: float
    weight: np.ndarray
    cells: tuple[int, int]
