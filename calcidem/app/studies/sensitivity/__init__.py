"""How much the choices of a campaign matter: variants of one configuration, computed with the same seeds."""
