"""One material law a file."""
