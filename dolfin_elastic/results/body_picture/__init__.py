"""Pictures of a body before it is computed: faces, names, supports, loads and obstacles."""
