"""From pixels to one sub-pixel position per row."""
