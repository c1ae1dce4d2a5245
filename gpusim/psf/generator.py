"""The lens model generator: from a prescription to PSFs, on the device.

Six stages, each a shader: in ``shaders/lens`` aim (rays at the stop) and trace (where they go, and
their path), in ``shaders/psf`` wavefront (W at the nodes of a grid of directions), pupil (the field
on the transform's grid, in any image plane), fft_along and fft_across (its transform, and the
intensity). The first three do not depend on the image plane and are done once: a re-focus costs the
last three.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import threadpool_limits

from gpusim.errors import UserError
from gpusim.gpu import Device, Kernel, Recording, Resident
from gpusim.lens.entering import Stretch, stretch
from gpusim.lens.samples import Losses, field_launch
from gpusim.lens.system import System
from gpusim.lens.throughput import goes_with_the_ray
from gpusim.lens.trace import trace
from gpusim.lens.tracer import Beams, starts
from gpusim.psf.aimed import AimedRays, Leads, aimed_rays
from gpusim.psf.boundary_wave import rim_lost
from gpusim.psf.chief_rays import ChiefRays
from gpusim.psf.cone import cone_of
from gpusim.psf.halo import through_few
from gpusim.psf.rim import beside, between_nodes, continued, rim_share
from gpusim.psf.transform import GRID, TRANSFORM, Transform, uploaded_grids
from gpusim.psf.wave import Wave

# Nodes across the pupil. The wavefront is interpolated between them with an error that goes with
# their spacing to the fourth power: 128 against 256 change PSFs by 2e-5 of their peak (double Gauss
# at f/2.8). The pupil itself is sampled on the transform's grid.
RAYS = 128
NO_RAY = 2.0  # reach of a node that no ray leads to: well beyond a rim
# Light of a node over the chief ray's, at least. Within their rims the library's pupils have 0.8 to
# 1.4 of it; beyond them the polynomials may say 0, which has no logarithm.
LEAST = 1e-3
SPARE = 3  # nodes beyond the pupil's bounds: cubic interpolation needs two


@dataclass(frozen=True)
class Spread:
    """PSFs of the beams of one field.

    Attributes
    ----------
    psf : ndarray of float32, shape (L, N, N)
        Share of the light per sample; rows eta, columns xi; sample j at (j - N / 2) pitch.
    entered : ndarray, shape (L,)
        What a point of the scene sends through the vignetted pupil: mm^2 across the beam, or sr
        along the object plane where that is near. See `gpusim.lens.entering`.
    folded_energy : ndarray, shape (L,)
        Share of rays that land beyond the transform's period, which would bring them back into the
        window: the PSFs leave them to the halo's levels.
    """

    psf: np.ndarray
    entered: np.ndarray
    folded_energy: np.ndarray


class Generator:
    """A lens, traced once at F fields and L wavelengths, that gives its PSFs at any focus.

    Parameters
    ----------
    device : Device
    system : System
    wavelengths_nm : ndarray, shape (L,)
    field_deg : ndarray, shape (F,)
        Field angles.
    pitch_um, size : float, int
        Pitch and size of the PSFs; size at most half of the transform.
    rays : int
        Nodes across the pupil each way; one half of them is traced, the other mirrors it.
    transform : int
        Cells of the pupil each way, 512 or 1024: the PSF repeats after so many samples.
    progress : callable, optional
        Called with (fields traced, fields in all).

    Attributes
    ----------
    chief_y_mm, chief_beta : ndarray, shape (F, L)
        Where the chief rays land, and their direction cosine there.
    between : ChiefRays
        Those of other fields.
    failed_rays : ndarray of int, shape (F, L)
        Rays aimed within the stop that did not arrive: see `gpusim.psf.aimed`.
    residual_waves : ndarray, shape (F, L)
        RMS difference of the interpolated wavefront from the rays that were aimed at the stop.

    Raises
    ------
    UserError
        No light passes at a field, or the pitch does not sample the PSF.
    """

    def __init__(
        self,
        device: Device,
        system: System,
        wavelengths_nm: np.ndarray,
        field_deg: np.ndarray,
        *,
        pitch_um: float,
        size: int,
        rays: int = RAYS,
        transform: int = TRANSFORM,
        progress: Callable[[int, int], None] | None = None,
    ) -> None:
        self.device, self.system = device, system
        self.wavelengths_nm, self.field_deg = wavelengths_nm, field_deg
        self.pitch_um, self.size, self._transform = pitch_um, size, transform
        self._lossy = goes_with_the_ray(system.prescription)
        self._filtered = self._lossy or system.prescription.gaussian_apodisation > 0
        self._na, self._nb = rays // 2, rays
        self._beams = Beams(device, system, wavelengths_nm, np.radians(field_deg))
        self.chief_y_mm, self.chief_beta = self._beams.chief_y_mm, self._beams.chief_beta
        self.between = ChiefRays(system, wavelengths_nm)
        self._stretches: dict[tuple[int, float], Stretch] = {}
        self._to_psfs = Transform(device, pitch_um=pitch_um, size=size, cells=transform)
        shape = (len(field_deg), len(wavelengths_nm))
        self._grids = np.zeros(shape, GRID)
        self.failed_rays = np.zeros(shape, np.int32)
        self.residual_waves = np.zeros(shape)
        self._entering_at_chief = np.zeros(shape)
        self._nodes: list[Resident] = []
        # -ln of the amplitude at the nodes, and how much of it stop, surfaces and glass take.
        self._exponents: list[Resident] = []
        self._lost: list[np.ndarray | float] = []
        try:
            self._trace_fields(progress)
        except BaseException:
            self.release()
            raise
        half_widths = self._na * self._grids["step"][..., 0] / self._grids["cell"]
        self._rows = int(np.ceil(half_widths.max()))

    def stretch(self, field: int, reference_nm: float) -> Stretch:
        """Return how the image is stretched about a field, by chief rays of one of the wavelengths.

        See `gpusim.lens.entering.stretch`.
        """
        key = field, reference_nm
        if key not in self._stretches:
            line = list(self.wavelengths_nm).index(reference_nm)
            launch = self._beams.launches[field]
            start = replace(launch, base=launch.base[:, [line]])
            self._stretches[key] = stretch(self.system, reference_nm, launch.theta, start=start)
        return self._stretches[key]

    def _trace_fields(self, progress: Callable[[int, int], None] | None) -> None:
        """Trace field by field, and keep the nodes."""
        lines = len(self.wavelengths_nm)
        failed, rays_of = aimed_rays(self._beams, self.system, self.field_deg, lines)
        self.failed_rays[:] = failed
        for field, aimed in enumerate(rays_of):
            # OpenBLAS's own threads wait by spinning, which costs more than they save here.
            with threadpool_limits(1):
                led = [self._lead(field, line, one) for line, one in enumerate(aimed)]
            started, entering, lost = zip(*led, strict=True)
            self._nodes.append(self._wavefront(field, np.concatenate(started)))
            self._lost.append(np.stack(lost) if self._filtered else 0.0)
            exponent = np.stack(entering) + self._lost[-1]
            self._exponents.append(self.device.resident("exponent", exponent.astype(np.float32)))
            self._check(field, aimed)
            if progress is not None:
                progress(field + 1, len(self.field_deg))

    def _lead(
        self, field: int, line: int, rays: AimedRays
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """Lay out the grids of one beam; return the rays that lead to its nodes, and their light.

        The light, shape (A, B), as -ln of the amplitude: that which enters, and what is lost of it
        where it is.
        """
        exponent = self._filter(field, line, rays) if self._filtered else None
        leads = Leads(rays, exponent)
        self._lay_out(field, line, leads)
        node_a, node_b = self._directions(field, line)
        p_x, p_y, *lost = leads.at(node_a, node_b)

        def etendue(x: np.ndarray, y: np.ndarray) -> np.ndarray:
            return self._beams.etendue(field, line, x, y)

        chief = leads.entering(etendue, np.zeros(1), self.chief_beta[field, [line]])[0, 0]
        light = np.maximum(leads.entering(etendue, node_a, node_b) / chief, LEAST)
        self._entering_at_chief[field, line] = chief
        near = leads.near(node_a, node_b)
        nodes = np.flatnonzero(near)
        started = starts(
            np.stack([one.ravel()[nodes] for one in (p_x, p_y)], axis=-1),
            np.full(len(nodes), field * len(self.wavelengths_nm) + line),
            line * near.size + nodes,
        )
        return started, -0.5 * np.log(light), lost[0] if lost else None

    def _lay_out(self, field: int, line: int, leads: Leads) -> None:
        """Lay out the grids of one beam."""
        rays, half, half_height = leads.rays, leads.half, leads.half_height
        alpha, beta = rays.alpha[rays.inside], rays.beta[rays.inside]
        self._check_pitch(line, max(2 * alpha.max(), np.ptp(beta)))
        # The rim lies within one spacing of the aimed rays beyond the last one inside.
        wide = min(half, alpha.max() + rays.apart[0] * half)
        bottom = max(rays.beta.min(), beta.min() - 2 * rays.apart[1] * half_height)
        top = min(rays.beta.max(), beta.max() + 2 * rays.apart[1] * half_height)
        wavelength_um = 1e-3 * self.wavelengths_nm[line]
        grid = self._grids[field, line]
        step_a = wide / (self._na - SPARE)
        step_b = (top - bottom) / (self._nb - 2 * SPARE)
        grid["first"] = step_a / 2, bottom - (SPARE - 0.5) * step_b
        grid["step"] = step_a, step_b
        grid["origin"] = 0, (bottom + top) / 2
        grid["cell"] = wavelength_um / (self._transform * self.pitch_um)
        grid["chief"] = 0, self.chief_beta[field, line]
        grid["waves_per_mm"] = 1e3 / wavelength_um

    def _filter(self, field: int, line: int, rays: AimedRays) -> np.ndarray:
        """Return -ln of the amplitude that stop, surfaces and glass pass of aimed rays, (R,)."""
        gaussian = self.system.prescription.gaussian_apodisation * rays.rho2
        if not self._lossy:
            return gaussian
        system, wavelength_nm = self.system, self.wavelengths_nm[line]
        index = system.index(np.array([wavelength_nm]))
        launch = field_launch(system, index, float(np.radians(self.field_deg[field])))
        px, py = rays.p_mm.astype(float).T[:, None]
        traced = trace(system.geometry, index, launch, px, py, crossings=True)
        lost = Losses(system.prescription, index, traced.crossings).exponent(0, wavelength_nm)
        return gaussian + lost

    def _check_pitch(self, line: int, width: float) -> None:
        """Refuse a pitch above the Nyquist limit of the PSF, lambda / (2 pupil width)."""
        wavelength_nm = self.wavelengths_nm[line]
        limit = wavelength_nm * 1e-3 / (2 * width)
        if self.pitch_um > limit:
            raise UserError(
                f"the PSF pitch is too coarse for this aperture at {wavelength_nm:g} nm",
                file=self.system.prescription.file,
                field="pitch_um",
                value=self.pitch_um,
                allowed=f"<= {limit:.3g}",
            )

    def _wavefront(self, field: int, rays: np.ndarray) -> Resident:
        """Trace the rays of one field's beams; return the nodes, kept on the device."""
        rec = Recording(self.device)
        shape = (len(self.wavelengths_nm), self._na, self._nb)
        nodes = self.device.empty("nodes", (*shape, 2), np.float32)
        start = rec.buffer("rays", rays.shape, "f4")
        opd, directions = (rec.buffer(name, (*shape, 4), "f4") for name in ("opd", "directions"))
        rec.upload(start, rays)
        rec.clear(opd)  # a reach of 0: no ray came here
        rec.clear(directions)
        self._beams.record_trace(rec, start, opd, directions)
        Kernel("psf/wavefront").record(
            rec,
            (-(-self._nb // 64), self._na, shape[0]),
            {"na": self._na, "nb": self._nb},
            grids=uploaded_grids(rec, self._grids[field]),
            opd=opd,
            directions=directions,
            nodes=nodes,
        )
        rec.run()
        return nodes

    def _check(self, field: int, aimed: list[AimedRays]) -> None:
        """Compare the interpolated wavefront with the rays that were aimed at the stop."""
        nodes = self.device.read(self._nodes[field])
        if (beside(nodes[..., 1]) & (nodes[..., 1] == 0)).any():
            nodes = continued(nodes)
            self.device.write(self._nodes[field], nodes)
        for line, rays in enumerate(aimed):
            grid = self._grids[field, line]
            at = np.stack([rays.alpha, rays.beta], axis=-1)[rays.inside]
            found = between_nodes(nodes[line], (at - grid["first"]) / grid["step"])
            if np.isnan(found).any():
                raise UserError(
                    f"rays at the pupil's rim fail at "
                    f"{self.field_deg[field]:.4g} deg: the wavefront is not known there",
                    file=self.system.prescription.file,
                    field="max_field_deg",
                    value=f"{self.field_deg[field]:.4g}",
                    allowed="a smaller field, or clear apertures within which the rays pass",
                )
            self.residual_waves[field, line] = np.std(found - rays.opd_waves[rays.inside])

    def _directions(self, field: int, line: int) -> tuple[np.ndarray, np.ndarray]:
        """Return alpha (A,) and beta (B,) of the nodes of one beam."""
        grid = self._grids[field, line]
        alpha = grid["first"][0] + np.arange(self._na) * grid["step"][0].astype(float)
        beta = grid["first"][1] + np.arange(self._nb) * grid["step"][1].astype(float)
        return alpha, beta

    def spread(self, field: int, focus_mm: float = 0.0, *, rim: bool = True) -> Spread:
        """Return the PSFs of one field.

        Parameters
        ----------
        field : int
        focus_mm : float
            How far the image plane is moved away from the lens.
        rim : bool
            Whether to add what sampling the rim loses: see `gpusim.psf.boundary_wave.rim_lost`.
        """
        nodes, exponent = self._nodes[field], self._exponents[field]
        psf, light, folded = self._to_psfs.spread(
            self._grids[field], nodes, exponent, self._rows, focus_mm
        )
        if rim:
            psf += self._rim_lost(field, 1e3 * focus_mm)
        return Spread(
            psf=psf,
            entered=2
            * light
            * self._grids[field]["cell"].astype(float) ** 2
            * self._entering_at_chief[field],
            folded_energy=folded,
        )

    def _rim_lost(self, field: int, focus_um: float) -> np.ndarray:
        """Return what sampling the rim takes from the PSFs (L, n, n) of a field."""
        period_um = 2 * (self._transform * float(self.pitch_um),)
        few, basis = through_few(self.wavelengths_nm)
        lost = [
            rim_lost(
                self.wave(field, line, focus_um),
                1e-3 * self.wavelengths_nm[line],
                self.size,
                float(self.pitch_um),
                period_um,
            )
            for line in few
        ]
        few_lost = np.array(lost, np.float32)
        return np.tensordot(basis.astype(np.float32), few_lost, 1)

    def wave(self, field: int, line: int, focus_um: float = 0.0) -> Wave:
        """Return the wavefront of one field and wavelength in an image plane, both halves."""
        nodes = self.device.read(self._nodes[field])[line].astype(float)
        grid = self._grids[field, line]
        alpha, beta = self._directions(field, line)
        reach = nodes[..., 1]
        passed = np.exp(-2.0 * self.device.read(self._exponents[field])[line])
        light = rim_share(reach[None])[0] * passed
        opd_um = 1e-3 * self.wavelengths_nm[line] * nodes[..., 0]
        beta_c = grid["chief"][1]
        chief = beta_c / np.sqrt(1 - beta_c**2)
        gamma = np.sqrt(np.maximum(1 - alpha[:, None] ** 2 - beta**2, 1e-6))
        opd_um += focus_um * (gamma + chief * beta - np.hypot(1, chief))

        def both(half: np.ndarray) -> np.ndarray:
            return np.concatenate([half[::-1], half])

        return Wave(
            alpha=np.concatenate([-alpha[::-1], alpha]),
            beta=beta,
            opd_um=both(opd_um),
            # No ray came where it is 0: as good as beyond the rim.
            reach=both(np.where(reach > 0, reach, NO_RAY)),
            light=both(light),
            passed=both(passed),
            mirrored=True,
        )

    def cones(self, field: int) -> np.ndarray:
        """Return the rays that arrive at one field, radial cosine first.

        Returns
        -------
        ndarray of float32 (L, R, 3)
            See ``gpusim.psf.cone``. A node on a rim counts with the share of its square inside.
        """
        reach = self.device.read(self._nodes[field])[..., 1].astype(float)
        light = rim_share(reach) * np.exp(-2.0 * self._lost[field])
        rays = []
        for line, of_line in enumerate(light):
            rays.append(cone_of(*self._directions(field, line), of_line, True)[:, [1, 0, 2]])
        return np.stack(rays)

    def release(self) -> None:
        """Give the device memory back."""
        self._beams.release()
        self._to_psfs.release()
        for one in (*self._nodes, *self._exponents):
            one.destroy()
