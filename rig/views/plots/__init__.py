"""Draw pictures of recordings and results without a display."""
