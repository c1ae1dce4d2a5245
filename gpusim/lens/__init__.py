"""What a lens is and what its rays do: prescription, glass, first order, trace, wavefront."""
