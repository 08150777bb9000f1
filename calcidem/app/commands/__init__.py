"""Commands of the command line, one module each: a typer function, and below it the plain functions that it calls."""
