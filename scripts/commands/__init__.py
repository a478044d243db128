"""What each command of `regmot` does with its arguments; a module is a group of commands."""
