"""Reproductions of published validations: measured in our renders, predicted by other programs."""
