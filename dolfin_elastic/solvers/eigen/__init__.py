"""Natural frequencies and linear buckling with SLEPc."""
