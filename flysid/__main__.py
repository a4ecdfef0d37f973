"""`python -m flysid`."""

from flysid.cli import main

if __name__ == "__main__":
    main()
