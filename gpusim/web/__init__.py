"""A page for a browser that replays a camera's read-out and development, without Python."""
