"""The commands of ``submaps``: one file each."""
