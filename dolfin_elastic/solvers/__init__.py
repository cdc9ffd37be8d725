"""How it is solved: assembly, Newton, statics and dynamics."""
