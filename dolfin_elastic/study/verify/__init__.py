"""The verification of an installation: small cases with references, and ranks compared."""
