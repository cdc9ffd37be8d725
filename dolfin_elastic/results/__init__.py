"""What people look at: files, tables and pictures made from the states of a solver."""
