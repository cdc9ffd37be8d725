"""Files that others have written, read safely, and files of ours, written in their place."""
