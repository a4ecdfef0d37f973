"""The studio: flysid in a browser, on the user's own machine.

A server on loopback (`serve`, `app`, `guard`), the flights of one ingested folder (`flights`, `pyramid`),
what they can identify (`channels`), jobs that are the command line itself (`jobs`, `runner`), and runs
(`runs`). The page is in `assets`: ES modules without a build step.
"""
