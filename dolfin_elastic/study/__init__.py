"""Several runs: on finer meshes until a result is known, and of cases with known results."""
