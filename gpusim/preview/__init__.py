"""A camera whose knobs are turned while one looks: drafts at once, then the picture itself."""
