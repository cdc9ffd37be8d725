"""Input files of other programs as cases: materials, supports, loads and steps beside the mesh."""
