"""Bodies of separate parts: each turned and moved, all on one mesh."""
