"""Files of a run: XDMF, history, summary, modes."""
