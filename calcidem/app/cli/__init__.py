"""The command line: a module for each command, named after it, with the function `<name>_command`."""
