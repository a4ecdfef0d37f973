"""A comparison as people read it: text, Markdown, JSON, figures for a paper, a page."""
