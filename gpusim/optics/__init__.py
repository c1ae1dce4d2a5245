"""From radiance on the ideal image plane to electrons per second at every photosite."""
