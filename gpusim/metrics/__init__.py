"""Measurements on images: from digital numbers back to the figures of a camera's data sheet."""
