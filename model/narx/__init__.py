"""Polynomial NARX models: terms, their free run, the search for them, what is fitted."""
