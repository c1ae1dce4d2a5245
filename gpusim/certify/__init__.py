"""The certificate: how far a render is from the truth, by probe pixels, in one error budget."""

from gpusim.certify.budget import Certificate, Probe, Share, compare
from gpusim.certify.engine import certify, glare_at, true_rates
from gpusim.certify.probes import choose_probes

__all__ = [
    "Certificate",
    "Probe",
    "Share",
    "certify",
    "choose_probes",
    "compare",
    "glare_at",
    "true_rates",
]
