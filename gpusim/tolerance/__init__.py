"""Tolerances: perturbed lenses of one camera, by differentials of the wavefront, to its SFR."""
