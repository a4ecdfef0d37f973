"""Facts about a flight, each computed in one place for every verb, page and document."""
