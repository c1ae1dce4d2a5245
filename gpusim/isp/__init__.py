"""From raw digital numbers to pictures: the DNG file, its colour data, and its development."""
