"""Files of other programs, read as what the domain knows: lenses, PSFs, glasses, sensors."""
