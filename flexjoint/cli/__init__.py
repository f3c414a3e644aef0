"""The command line: what all commands share, and a folder of commands for each subject."""
