"""Commands that help to begin: new, schema, verify, and names of commands that are misspelt."""
