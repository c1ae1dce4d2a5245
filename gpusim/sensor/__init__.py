"""The sensor, from photons to digital numbers: its model, and the stages from mosaic to adc."""
