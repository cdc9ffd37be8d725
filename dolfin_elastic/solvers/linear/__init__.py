"""Linear solvers: which one, its preconditioner and its null spaces."""
