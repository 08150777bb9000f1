"""``calcidem packing``: the packing of a campaign alone."""

import typer

from calcidem.app.cli.arguments import DEFAULT_CONFIGURATION, ConfigurationFile


def packing_command(configuration: ConfigurationFile = DEFAULT_CONFIGURATION) -> None:
    """Report on the packing of a campaign; unless it comes with calcidem, it is made and kept in the cache."""
    from calcidem.app.campaign.packing import provide_packing
    from calcidem.app.cli.tables import packing_lines
    from calcidem.app.config.reader import load_configuration

    for line in packing_lines(provide_packing(load_configuration(configuration), None, typer.echo)):
        typer.echo(line)
