"""What energies of users may use: names, and a history of their own."""
