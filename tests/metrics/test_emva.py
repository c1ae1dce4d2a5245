"""The EMVA 1288 measurement on a camera that NumPy simulates, and on exact curves."""

import dataclasses
import math

import numpy as np
import pytest
from metrics.made import Camera
from scipy.stats import norm

from gpusim.errors import UserError
from gpusim.metrics.emva import characterise
from gpusim.metrics.statistics import Accumulator, Level, Parts

LEVEL = 1e-4  # of each comparison; the seeds are fixed
BOUND = norm.isf(LEVEL / 2)
MONO = ("W",)


def agrees(figure, planted):
    if figure.square is None:
        return abs(figure.value - planted) < BOUND * figure.u
    return abs(figure.square - planted**2) < BOUND * figure.square_u


@pytest.fixture(scope="module")
def found():
    camera = Camera(offset_row_e=1.0, response_col=0.01, row_noise_e=1.5)
    return characterise(camera.levels(), MONO)


@pytest.mark.parametrize(
    ("figure", "planted"),
    [
        ("system_gain_dn_per_e", 0.8),
        ("temporal_dark_noise_e", math.hypot(4.0, 1.5)),
        ("row_noise_e", 1.5),
        ("column_noise_e", 0.0),
        ("dark_current_e_per_s", 20.0),
        ("dark_current_variance_e_per_s", 20.0),
        ("dsnu_e", math.hypot(2.0, 1.0)),
        ("dsnu_pixel_e", 2.0),
        ("dsnu_row_e", 1.0),
        ("dsnu_column_e", 0.0),
    ],
)
def test_the_dark_figures_are_recovered(found, figure, planted):
    assert agrees(found.figures[figure], planted), found.figures[figure]


@pytest.mark.parametrize(
    ("figure", "planted"),
    [
        ("system_gain_dn_per_e", 0.8),
        ("quantum_efficiency", 0.55),
        ("responsivity_dn_per_photon", 0.44),
        ("prnu_percent", 100 * math.hypot(0.02, 0.01)),
        ("prnu_pixel_percent", 2.0),
        ("prnu_row_percent", 0.0),
        ("prnu_column_percent", 1.0),
        ("response_gain_dn_per_e", 0.8),
    ],
)
def test_the_bright_figures_are_recovered(found, figure, planted):
    assert agrees(found.channels[0].figures[figure], planted), found.channels[0].figures[figure]


def test_derived_figures_follow_their_equations(found):
    """Equation (17) of the threshold, the dynamic range and the highest SNR."""
    of = {name: one.value for name, one in found.channels[0].figures.items()}
    noise = found.figures["temporal_dark_noise_dn"].value / of["system_gain_dn_per_e"]
    assert of["sensitivity_threshold_e"] == pytest.approx(noise + 0.5)
    threshold = (noise + 0.5) / of["quantum_efficiency"]
    assert of["sensitivity_threshold_photons"] == pytest.approx(threshold)
    assert of["dynamic_range"] == pytest.approx(of["saturation_photons"] / threshold)
    assert of["snr_max"] ** 2 == pytest.approx(of["quantum_efficiency"] * of["saturation_photons"])


def test_saturation_is_where_the_variance_is_highest_and_below_the_full_well(found):
    transfer = found.channels[0].transfer
    at = transfer.saturation
    assert transfer.variance[at] == transfer.variance.max()
    capacity = found.channels[0].figures["saturation_e"].value
    assert 0.85 * 4000 < capacity < 4000


def test_the_uncertainties_are_the_spread_of_repeated_measurements():
    """Measurements of 24 other cameras of the same type give z-scores of unit variance."""
    scores = []
    for seed in range(24):
        camera = Camera(seed=100 + seed, shape=(40, 40))
        one = characterise(camera.levels(count=20, stack=8), MONO)
        figures = {**one.figures, **one.channels[0].figures}
        scores.append([
            (figures[name].value - planted) / figures[name].u
            for name, planted in (
                ("system_gain_dn_per_e", 0.8),
                ("quantum_efficiency", 0.55),
                ("temporal_dark_noise_e", 4.0),
                ("dark_current_e_per_s", 20.0),
                ("dsnu_e", 2.0),
                ("prnu_percent", 2.0),
            )
        ])  # fmt: skip
    # Chi-square of 24 scores, by figure: 0.01 % quantiles 5.6/24 and 61/24.
    squares = np.mean(np.square(scores), axis=0)
    assert np.all(squares > 5.6 / 24), squares
    assert np.all(squares < 61 / 24), squares


def test_response_after_the_shot_noise_is_found_out():
    """The slope of the pixels' noise is 2 K where the signal is multiplied afterwards."""
    camera = Camera(after_shot_noise=True)
    figure = characterise(camera.levels(), MONO).channels[0].figures["response_gain_dn_per_e"]
    assert not agrees(figure, 0.8)
    assert agrees(figure, 1.6)


def test_linearity_of_a_bent_camera():
    """A response bent by 2 % of full scale shows as such, and a straight one does not."""
    camera = Camera(response=0.0, seed=3)
    straight = characterise(camera.levels(), MONO).channels[0]
    assert straight.figures["linearity_error_max_percent"].value < 0.5
    bent = Camera(response=0.0, seed=3)
    frame = bent.frame

    def curved(photons, exposure_s):
        return frame(photons * (1 - 0.1 * photons / 8000), exposure_s)

    bent.frame = curved
    errors = characterise(bent.levels(), MONO).channels[0].figures
    assert errors["linearity_error_min_percent"].value < -1
    assert errors["linearity_error_max_percent"].value > 1


def test_channels_are_measured_at_the_wavelength_they_respond_to():
    """Two channels, two lights: each takes the one that it sees."""
    rng = np.random.default_rng(8)
    efficiency = {450.0: (0.5, 0.05), 600.0: (0.1, 0.4)}

    def level(photons, nm=None, frames=2):
        statistics = Accumulator((1, 2))
        share = np.tile(efficiency.get(nm, (0.0, 0.0)), (60, 30))
        for _ in range(frames):
            charge = np.minimum(rng.poisson(share * photons), 2000) + 3 * rng.standard_normal(
                share.shape
            )
            statistics.add(np.round(charge + 50).astype(np.uint16))
        return Level(0.01, photons, nm, statistics.sites())

    levels = [level(0.0)] + [
        level(2000 / max(of) * step, nm)
        for nm, of in efficiency.items()
        for step in np.linspace(0.05, 1.2, 24)
    ]
    blue, red = characterise(levels, ("B", "R")).channels
    assert (blue.wavelength_nm, red.wavelength_nm) == (450.0, 600.0)
    assert agrees(blue.figures["quantum_efficiency"], 0.5)
    assert agrees(red.figures["quantum_efficiency"], 0.4)


def test_what_the_standard_asks_for_and_the_data_lack_is_noted():
    camera = Camera(black_dn=0.0)
    levels = [camera.level(0.0)] + [camera.level(400.0 * (k + 1)) for k in range(20)]
    notes = " ".join(characterise(levels, MONO).notes)
    for word in ("20 levels", "DSNU", "dark current", "black level"):
        assert word in notes


def exact(mean, variance, photons, exposure_s=0.01):
    """Return a level with this mean and variance, of a pair of 20 x 20 pixels."""
    site = Camera(shape=(20, 20)).level(100.0).sites[0]
    temporal = Parts(variance, variance, 0.0, 0.0, *(variance**2 / 200,) * 4)
    site = dataclasses.replace(site, mean=mean, temporal=temporal)
    return Level(exposure_s, photons, None, (site,))


def straight(count=20):
    """Return a camera of gain 1/2 and efficiency 1, saturated from level 18 on."""
    lit = [exact(10 + 50.0 * k, 4 + 25.0 * k, 100.0 * k) for k in range(1, count - 1)]
    return [exact(10.0, 4.0, 0.0), *lit, exact(910.0, 1.0, 100.0 * count)]


def test_an_exact_curve_gives_exact_figures():
    of = characterise(straight(), MONO).channels[0].figures
    assert of["system_gain_dn_per_e"].value == pytest.approx(0.5)
    assert of["quantum_efficiency"].value == pytest.approx(1.0)
    assert of["saturation_e"].value == pytest.approx(1800)
    assert of["linearity_error_max_percent"].value == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize(
    ("levels", "words"),
    [
        ([], "no dark frames"),
        ([exact(10, 4, 0)], "no lit frames"),
        (straight()[1:], "no dark frames"),
        ([*straight(), exact(30, 8, 450.0)], "out of order"),
        (straight()[:-1], "do not reach saturation"),
        ([exact(10, 4, 0), *(exact(910, 0, 100.0 * k) for k in range(1, 9))], "is saturated"),
        ([exact(10, 4, 0), *(exact(910, 9 - k, 100.0 * k) for k in range(1, 9))], "is saturated"),
        ([*straight(), exact(300, 20, 777.0, exposure_s=0.5)], "exposure time without dark"),
        ([straight()[0], *straight()[-4:]], "too few levels"),
    ],
)
def test_what_cannot_be_measured_is_refused(levels, words):
    with pytest.raises(UserError, match=words):
        characterise(levels, MONO)
