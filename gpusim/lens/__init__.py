"""From a published prescription to a bank of point-spread functions, in float64 NumPy."""
