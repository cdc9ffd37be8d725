"""How the suite runs: which tests, on how many ranks, and what they cost."""
