"""From a lens to its bank of point-spread functions: pupils, diffraction, fields, storage."""
