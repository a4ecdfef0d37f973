"""`python -m flysid`."""

from flysid.surroundings import keep_working_folder_out

keep_working_folder_out()  # before anything is imported that a file in it could stand for

from flysid.cli import main  # noqa: E402

if __name__ == "__main__":
    main()
