"""The doors: what a user types, as a process of its own, in a folder of its own, unreduced.

`make doors` runs these alone, `make test` among the others. A page's command lines run one after another, as
a reader types them; what the page prints below a line is compared. A page's inputs come from `scenes`.
"""
