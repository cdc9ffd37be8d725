"""FEBio models as cases."""
