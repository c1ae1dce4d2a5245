"""The certificate: how far a render is from the exact model, at probe pixels, in one budget."""

from gpusim.certify.bank import bank_share
from gpusim.certify.budget import Certificate, Judged, Measure, Placed, Probe, Share, compare
from gpusim.certify.engine import ExactModel, certify, glare_at
from gpusim.certify.probes import choose_probes
from gpusim.certify.sensor import MeanSignal, sensor_share

__all__ = [
    "Certificate",
    "ExactModel",
    "Judged",
    "MeanSignal",
    "Measure",
    "Placed",
    "Probe",
    "Share",
    "bank_share",
    "certify",
    "choose_probes",
    "compare",
    "glare_at",
    "sensor_share",
]
