"""What lens designers look at, as numbers in float64: no figures and no device.

Rays meet the stop at points that are relative to its radius: (0, 1) is the upper rim. Aberrations
lie about the chief ray of the primary wavelength. An OPD is positive where the wavefront is ahead
of the reference sphere, as Hopkins, Welford and most lens programs have it: the sign opposite to
that of ``gpusim.lens.wavefront``. Along a fan the transverse aberration is R dW/d(direction cosine)
on a sphere so large that R dW/dy becomes dW/d beta.
"""
