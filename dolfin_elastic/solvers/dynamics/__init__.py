"""Motion: what implicit and explicit time integration share."""
