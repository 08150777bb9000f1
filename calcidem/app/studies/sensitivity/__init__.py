"""Effect of the choices of a campaign: variants of one configuration, computed with the same seeds."""
