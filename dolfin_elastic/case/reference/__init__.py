"""The keys of a case file as data: their JSON schema, and the tables of the documentation."""
