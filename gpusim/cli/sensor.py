"""``gpusim sensor``."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping
from pathlib import Path

import yaml
from rich.console import Console
from rich.table import Table
from rich.text import Text

from gpusim.cli.files import whole_file
from gpusim.config.mistakes import UNITS
from gpusim.config.text import parse_yaml, read_yaml
from gpusim.errors import UserError
from gpusim.formats.isetcam_sensor import read_isetcam
from gpusim.formats.speos import is_speos, read_speos
from gpusim.sensor.conversion import Conversion, sensor_text
from gpusim.sensor.load import load_sensor, presets
from gpusim.sensor.sensor import Sensor

ISETCAM, YAML = (".mat", ".json"), (".yaml", ".yml")
LONGEST = 200  # characters of a value
# EMVA 1288's names of fields.
SYMBOLS = {
    "quantum_efficiency": "eta",
    "system_gain_dn_per_e": "K",
    "full_well_e": "mu_e.sat",
    "temporal_dark_noise_e": "sigma_d",
    "dark_current_e_per_s": "mu_I",
    "dsnu_e": "DSNU",
    "prnu_percent": "PRNU",
}


def run(name: str | None, settings: list[str], out: Path | None) -> None:
    """Show the data sheet of a sensor; write its file where `out` asks for it.

    Without a name, list the sensors that come with the package.
    """
    if name is None:
        if settings or out is not None:
            raise UserError(
                "the options need a sensor",
                field="SENSOR",
                allowed=", ".join(presets()) + ", a file",
            )
        Console().print(library())
        return
    made = conversion(name)
    sensor = made.sensor(settled(made.fields, map(setting, settings)))
    console = Console()
    console.print(data_sheet(sensor))
    for text in made.unused:
        console.print(Text(f"not used: {text}"))
    if out is not None:
        with whole_file(out, YAML) as file:
            file.write_text(sensor_text(sensor, f"Made from {Path(name).name}."), "utf-8")
        print(out)


def conversion(name: str) -> Conversion:
    """Return the fields of a preset, a sensor file, or another program's sensor."""
    path = Path(name)
    if path.suffix.lower() in ISETCAM:
        return read_isetcam(path)
    if path.suffix.lower() in YAML and is_speos(read_yaml(path, "the sensor file")):
        return read_speos(path)
    # Files beside a sensor file are found from anywhere by their whole paths.
    sensor = load_sensor(path.resolve() if path.suffix else name)
    fields = sensor.model_dump(exclude_unset=True, exclude={"sources"})
    return Conversion(path, fields, dict(sensor.sources))


def setting(text: str) -> tuple[str, object]:
    """Return a field's name and its value from ``FIELD=VALUE``, the value as in YAML."""
    field, sign, value = text.partition("=")
    try:
        found = parse_yaml(value)
    except ValueError:
        found = None
    if not sign or found is None:
        raise UserError(
            "not a field with a value", field="--set", value=text, allowed="FIELD=VALUE: rows=480"
        )
    return field.strip(), found


def settled(
    fields: Mapping[str, object], settings: Iterable[tuple[str, object]]
) -> dict[str, object]:
    """Return the fields that settings change; a dotted name, ``cfa.pattern``, is one in a part."""
    given: dict[str, object] = {}
    for dotted, value in settings:
        field, *inner = dotted.split(".")
        if not inner:
            given[field] = value
            continue
        start = given.get(field, fields.get(field))
        part = given[field] = copy.deepcopy(start) if isinstance(start, dict) else {}
        for name in inner[:-1]:
            if not isinstance(part.get(name), dict):
                part[name] = {}
            part = part[name]
        part[inner[-1]] = value
    return given


def library() -> Table:
    """Return the sensors that come with the package."""
    table = Table("sensor", "pixels", "pitch", "filters", "", box=None, header_style="bold")
    for name in presets():
        sensor = load_sensor(name)
        pattern = "".join(sensor.site_channels())
        table.add_row(
            name,
            f"{sensor.cols} x {sensor.rows}",
            f"{sensor.pixel_pitch_um:.4g} um",
            pattern,
            Text(sensor.name),
        )
    return table


def data_sheet(sensor: Sensor) -> Table:
    """Return the fields of a sensor with EMVA 1288's symbols, units and sources."""
    table = Table("field", "", "value", "source", box=None, header_style="bold")
    fields = sensor.model_dump(mode="json", exclude_defaults=True, exclude={"sources"})
    for field, value in fields.items():
        source = sensor.sources.get(field, "")
        style = "yellow" if source.startswith("assumed") else ""
        table.add_row(
            field, SYMBOLS.get(field, ""), Text(shown(field, value)), Text(source, style=style)
        )
    return table


def shown(field: str, value: object) -> str:
    """Return a field's value with its unit; of curves the peaks, of tables their rows."""
    match field:
        case "quantum_efficiency":
            grid, curves = value["wavelengths_nm"], value["channels"]
            peaks = (
                f"{name} {max(curve):.3f} at {grid[curve.index(max(curve))]:g} nm"
                for name, curve in curves.items()
            )
            return "; ".join(peaks)
        case "eqe_map":
            return (
                f"{value['file']}: {len(value['wavelengths_nm'])} wavelengths, theta to "
                f"{value['theta_deg'][-1]:g} deg, {len(value['phi_deg'])} azimuths"
            )
        case "cfa":
            return " / ".join(" ".join(row) for row in value["pattern"])
    if isinstance(value, float):
        unit = next((unit for end, unit in UNITS.items() if field.endswith(end)), "")
        return f"{value:.6g} {unit.partition(';')[0]}".rstrip()
    if isinstance(value, dict | list):
        text = yaml.safe_dump(value, default_flow_style=True, sort_keys=False, width=10_000).strip()
        return text if len(text) <= LONGEST else f"{text[:LONGEST]} ..."
    return str(value)
