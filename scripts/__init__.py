"""The command `regmot`: arguments and files."""
