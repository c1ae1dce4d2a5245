"""Writers of lens files as other programs write them, for tests of the readers."""


def zmx_text(prescription, image_distance_mm):
    """Write a prescription as Zemax does: curvatures, one block for each surface."""
    lines = prescription.design_wavelengths_nm
    primary = lines.index(prescription.reference_nm) + 1
    if prescription.f_number is not None:
        aperture = f"FNUM {prescription.f_number!r} 0"
    elif prescription.object_na is not None:
        aperture = f"OBNA {prescription.object_na!r} 0"
    else:
        aperture = f"ENPD {prescription.entrance_pupil_diameter_mm!r}"
    distance = prescription.object_distance_mm
    text = [
        "VERS 140730 195 26155",
        "MODE SEQ",
        f"NAME {prescription.title}",
        f"NOTE 0 {prescription.source}",
        "UNIT MM X W X CM MR CPMM",
        aperture,
        "ENVD 2.0E+1 1 0",
        "GFAC 0 0",
        f"GCAT {' '.join(prescription.glass_catalogues)} MISC",
        "RAIM 0 2 1 1 0 1 0 0 0",
        f"FTYP 0 0 3 {len(lines)} 0 0 0",
        "XFLN 0 0 0 0 0 0 0 0 0 0 0 0",
        f"YFLN 0 {0.7 * prescription.max_field_deg!r} {prescription.max_field_deg!r} 0 0 0 0 0",
        "VDXN 0 0 0 0 0",
        "VDYN 0 0 0 0 0",
        "VCXN 0 0 0 0 0",
        "VCYN 0 0 0 0 0",
        "VANN 0 0 0 0 0",
        *(f"WAVM {i} {w / 1e3!r} 1" for i, w in enumerate(lines, start=1)),
        "WAVM 4 0.55 1",  # unused entries follow the used ones
        f"PWAV {primary}",
        "COFN QF COATING.DAT",
        "SURF 0",
        "  TYPE STANDARD",
        "  CURV 0.0 0 0 0 0",
        f"  DISZ {'INFINITY' if distance is None else repr(distance)}",
        "  DIAM 0 0 0 0 1",
    ]
    surfaces = prescription.surfaces
    for number, surface in enumerate(surfaces, start=1):
        text += [f"SURF {number}"] + (["  STOP"] if number == prescription.stop else [])
        terms = surface.asphere.coefficients
        kind = "XASPHERE" if any(terms[8:]) else "EVENASPH" if any(terms) else "STANDARD"
        thickness = image_distance_mm if number == len(surfaces) else surface.thickness
        text += [
            f"  TYPE {kind}",
            f"  CURV {surface.vertex_curvature!r} 0 0 0 0",
            "  HIDE 0 0 0 0 0 0 0 0 0 0",
        ]
        if kind == "EVENASPH":
            text += [f"  PARM {i} {a!r}" for i, a in enumerate(terms[:8], start=1)]
        if kind == "XASPHERE":  # of powers of r / 2 mm; 2 keeps the coefficients exact
            text += [f"  XDAT 1 {len(terms)} 0 0", "  XDAT 2 2.0 0 0"]
            text += [f"  XDAT {i + 2} {a * 4**i!r} 0 0" for i, a in enumerate(terms, start=1)]
        text += [f"  DISZ {thickness!r}"]
        if surface.conic:
            text.append(f"  CONI {surface.conic!r}")
        if surface.glass == "model":
            text.append(f"  GLAS ___BLANK 1 0 {surface.nd!r} {surface.vd!r} 0 0 0 0 0 0")
        elif surface.glass == "constant":
            text.append(f"  GLAS ___BLANK 1 0 {surface.nd!r} 0 0 0 0 0 0 0")
        elif surface.glass:
            text.append(f"  GLAS {surface.glass} 0 0 1.5 40.0 0 0 0 0 0 0")
        if surface.semi_diameter is None and number != prescription.stop:
            text.append("  MEMA 1.0 1 0 0 1")
        else:
            text.append(f"  DIAM {surface.semi_diameter or 1.0!r} 1 0 0 1")
    text += [
        f"SURF {len(surfaces) + 1}",
        "  TYPE STANDARD",
        "  CURV 0.0 0 0 0 0",
        "  DISZ 0",
        "  DIAM 1 0 0 0 1",
        "TOL TOFF 0 0",
        "EFLY 0 2 0 0",
    ]
    return "\r\n".join(text) + "\r\n"


def seq_text(prescription, image_distance_mm, radii=True, unit="M"):
    """Write a prescription as CODE V does, its catalogue glasses as NAME_CATALOGUE."""
    per_mm = {"M": 1.0, "C": 0.1, "I": 1 / 25.4}[unit]
    if prescription.f_number is not None:
        aperture = f"FNO   {prescription.f_number!r}"
    elif prescription.object_na is not None:
        aperture = f"NAO   {prescription.object_na!r}"
    else:
        aperture = f"EPD   {prescription.entrance_pupil_diameter_mm * per_mm!r}"
    text = [
        "RDM" + ("" if radii else " N") + ';LEN      "VERSION: 10.7"',
        f"TITLE '{prescription.title}'",
        aperture,
        f"DIM   {unit}",
        "WL    " + " ".join(repr(w) for w in prescription.design_wavelengths_nm),
        f"REF   {prescription.design_wavelengths_nm.index(prescription.reference_nm) + 1}",
        "WTW   1 1 1",
        "INI   'our own'   ! nobody else's",
        "XAN   0.0 0.0 0.0",
        f"YAN   0.0 {0.7 * prescription.max_field_deg!r} &",
        f"  {prescription.max_field_deg!r}",
        "VUY   0.0 0.0 0.0; VLY 0.0 0.0 0.0",
        f"SO    0.0 {(prescription.object_distance_mm or 1e13) * per_mm!r}",
    ]
    surfaces = prescription.surfaces
    for number, surface in enumerate(surfaces, start=1):
        thickness = image_distance_mm if number == len(surfaces) else surface.thickness
        curvature = surface.vertex_curvature
        shape = (1 / curvature if curvature else 0.0) * per_mm if radii else curvature / per_mm
        words = ["S    ", repr(shape), repr(thickness * per_mm)]
        if surface.glass in ("model", "constant"):
            # Six decimals of nd, four of Vd: as many as the code has.
            words.append(f"{surface.nd - 1:.6f}"[2:] + "." + f"{surface.vd:07.4f}".replace(".", ""))
        elif surface.glass:
            words.append(glass_words(surface.glass, prescription.glass_catalogues))
        text.append(" ".join(words))
        text.append("  CCY 0; THC 0")
        if number == prescription.stop:
            text.append("  STO")
        if surface.semi_diameter is not None:
            text.append(f"  CIR {surface.semi_diameter * per_mm!r}")
        terms = surface.asphere.coefficients
        if any(terms):
            text.append("  ASP")
        elif surface.conic:
            text.append("  CON")
        if surface.conic:
            text.append(f"  K   {surface.conic!r}")
        if any(terms):
            scaled = [a * per_mm ** (1 - 2 * i) for i, a in enumerate(terms, start=1)]
            pairs = [
                f"{letter}   {a!r}" for letter, a in zip("ABCDEFGHJ", scaled[1:], strict=False)
            ]
            text.append("  CUF 0.0")
            text.append("  " + "; ".join(pairs))
    text += ["  PIM", "SI    0.0 0.0", "GO"]
    return "\r\n".join(text) + "\r\n"


def glass_words(name, catalogues):
    """CODE V's name of a glass: no hyphens, the catalogue behind an underscore."""
    books = {"H-LAK1": "CDGM", "H-K9L": "CDGM"}
    assert set(catalogues) <= {"SCHOTT", "CDGM"}
    return f"{name.replace('-', '')}_{books.get(name, 'SCHOTT')}"


def pbrt_text(prescription, image_distance_mm, stop_diameter_mm):
    """Write a prescription whose stop is a diaphragm as pbrt's lens files are."""
    text = [f"# {prescription.title}", "# radius thickness index aperture-diameter"]
    surfaces = prescription.surfaces
    for number, surface in enumerate(surfaces, start=1):
        thickness = image_distance_mm if number == len(surfaces) else surface.thickness
        if number == prescription.stop:
            text.append(f"0 {thickness!r} 0 {stop_diameter_mm!r}")
        else:
            radius = 1 / surface.vertex_curvature
            nd = surface.nd if surface.glass else 1
            text.append(f"{radius!r}\t{thickness!r}\t{nd!r}\t{2 * surface.semi_diameter!r}")
    return "\n".join(text) + "\n"
