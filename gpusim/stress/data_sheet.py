"""Cases of the EMVA 1288 measurement: data sheets at the ends of what there is, measured again."""

from __future__ import annotations

from collections.abc import Callable

from gpusim.gpu import default_device
from gpusim.metrics import flat_field, loop
from gpusim.metrics.emva import characterise
from gpusim.plan.stages import sensor_runs
from gpusim.stress.made import mono
from gpusim.stress.table import Case

SIGMAS = 5.0  # that ten figures do not exceed by chance: 6e-6


def measured_again(**changes: float) -> Callable[[], tuple]:
    """Return the case of a sensor with some figures, of which all are to be recovered."""

    def case() -> tuple:
        sensor = mono(128, 160).model_copy(update={"full_well_e": 8180.0, **changes})
        wanted = flat_field.lights(sensor, levels=24, stack=16)
        levels = flat_field.measure(sensor, wanted, default_device(), sensor_runs(sensor), seed=11)
        rows = loop.rows(characterise(list(levels), sensor.site_channels()), sensor)
        worst = max(rows, key=lambda row: row.sigmas)
        got = f"{worst.parameter} {worst.sigmas:.1f} sigma off at most, of {len(rows)} figures"
        return f"its figures within {SIGMAS:g} sigma", got, worst.sigmas < SIGMAS

    return case


CASES: tuple[Case, ...] = (
    ("data sheet of a sensor of 100 electrons", measured_again(
        full_well_e=100.0, system_gain_dn_per_e=20.0, temporal_dark_noise_e=0.2, dsnu_e=0.1
    ), None),
    ("data sheet of a sensor of 1e6 electrons", measured_again(
        full_well_e=1e6, bit_depth=16, system_gain_dn_per_e=0.06, temporal_dark_noise_e=40.0
    ), None),
    ("data sheet of a sensor without noise", measured_again(
        temporal_dark_noise_e=0.0, dsnu_e=0.0, prnu_percent=0.0, dark_current_e_per_s=0.0
    ), None),
    ("data sheet through steps of 33 electrons", measured_again(
        system_gain_dn_per_e=0.03, bit_depth=8, black_level_dn=4.0
    ), None),
    ("data sheet of a hot sensor", measured_again(dark_current_e_per_s=1e5), None),
    ("data sheet of a converter of 1 bit", measured_again(bit_depth=1, black_level_dn=0.2),
     "bit_depth"),
)  # fmt: skip
